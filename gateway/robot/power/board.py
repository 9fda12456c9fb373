"""What is sent to the power board and when, and what its answers mean. No I/O, no clock: frames and times in and out.

- **Off** goes out at once, and again every 20 ms until it is confirmed, for 3 s.
- **On** waits until each off is confirmed, or late, and the board's counter is at rest: 5 ms behind its answer. The
  board answers once all are on, so that six go on at a time. It is only sent while the board answers, so that no queue
  of a broken link delivers it later.
- **Confirmed** is an answer 6B that was given after the mask had reached the board (offs.py). The board answers
  questions in its receive interrupt, masks later: so one that comes behind the answer to a question that was sent after
  the mask (questions.py).
- **Nothing comes on unasked.** A board whose error is deleted feeds all of the last mask again.
  So each mask leaves out outputs that it has blocked, that another node took, or that were off after a silence, until
  the owner has once not wanted their servos and then wants them anew.
"""

from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from typing import Final, NamedTuple

from gateway.allowance import NS_PER_MS
from gateway.model.power_board import (
    ALL,
    OUTPUTS,
    SET_SUPPLY,
    TWO_BOARDS,
    BoardError,
    CanFrame,
    Cleared,
    Currents,
    GoingOff,
    NoError,
    OffPressed,
    Rails,
    Supplied,
    mask_of,
    read,
    set_supply,
)
from gateway.robot.power.errors import BoardErrors
from gateway.robot.power.offs import Confirmed, OutputsOff
from gateway.robot.power.questions import BoardQuestions
from schemas.telemetry import Kind

REPEAT_NS: Final = 20 * NS_PER_MS
"""Between two masks, until what is off is confirmed."""
START_NS: Final = 1000 * NS_PER_MS
"""Behind the first opening nothing is reported as not confirmed: a gateway that starts keeps its threads waiting."""
REPEAT_FOR_NS: Final = 3000 * NS_PER_MS
"""Longer than a lost question is waited for (questions.FORGOTTEN_NS): before, a link that lost six confirms nothing."""
REPEAT_ON_NS: Final = 100 * NS_PER_MS
"""Between two masks, until what is on is confirmed, and at least until the answer to the first is overdue."""
REST_NS: Final = 5 * NS_PER_MS
"""Behind an answer 6B: within a pass of the board's loop (2 ms at most) its counter is one too far."""
STEP_NS: Final = 54 * NS_PER_MS
"""The longest time for 27 passes of the board's loop: until the answer, and for each output that goes on."""
LASTS_NS: Final = 1000 * NS_PER_MS
"""Without a frame of its kind for this long, a state that was reported once has ended, and is reported again."""

_OFF_PRESSED: Final = "somebody pressed the power board's off button"
_GOING_OFF: Final = "somebody has asked the power board to switch the whole robot off, and it does in 1 s"
_SIXES: Final = (0o77, 0o77 << 6, 0o77 << 12)
NOTHING: Final = -1
"""No mask has this number, or a smaller one."""


class News(NamedTuple):
    """An event to publish: its sentence, and the servos that it concerns."""

    kind: Kind
    detail: str
    servos: frozenset[int] = frozenset()


class Status(NamedTuple):
    """What is known of the board at one time. Servos by their ids."""

    alive: bool = False
    """Whether it answers."""
    supplied: frozenset[int] = frozenset()
    """Fed, by its last answer."""
    confirmed: bool = False
    """It has confirmed that all is off which is to be off."""
    lost: frozenset[int] = frozenset()
    """Wanted, and not fed, though we have not taken their supply."""
    refused: Mapping[int, str] = {}
    """Blocked by the board, so not fed whatever is wanted: why."""
    fed: frozenset[int] = frozenset()
    """Confirmed to be fed, since that was last wanted."""
    changes: int = 0
    """The number of the newest `want`."""
    answered_ns: int | None = None
    """When it last answered; None: never."""
    currents_ma: Mapping[int, int] = {}
    """What each servo draws, as far as measured since the board answers."""
    rails: Mapping[int, tuple[int, ...]] = {}
    """The newest answers about rails, by the question's identifier, in mA, mV and °C."""


class PowerBoard:
    """One board. Each method belongs to one owner at a time; `now_ns` is monotonic and the same clock for all."""

    def __init__(self, outputs: Sequence[int], *, confirm_ns: int) -> None:
        """`outputs`: the servo on each output, from output 1 on. `confirm_ns`: what is confirmed later is reported."""
        self._servos = tuple(outputs)
        self._bit = {servo: 1 << place for place, servo in enumerate(outputs)}
        self._news: deque[News | Confirmed] = deque()
        # What is wanted. Nothing is sent before the first want or cut.
        self._begun = self._cut = False
        self._changes = 0
        self._wanted = 0
        self._lost = 0
        self._unknown = 0
        """Lost to a silence: perhaps still fed, and a leg may land on them. Only the owner has a mask take them."""
        # What was sent: 0 is also what a board feeds that has started anew.
        self._sent = 0
        self._number = self._on_number = 0
        """Of the newest mask, and of the newest one that switches something on."""
        self._sent_ns: int | None = None
        self._leave_ns: int | None = None
        """When the next mask leaves; None: none has to."""
        self._repeat_until_ns = 0
        self._answer_ns = -REST_NS
        """When the board last sent its mask."""
        self._rest_ns = 0
        """From when on its counter is at rest."""
        self._on_until_ns = 0
        self._off = OutputsOff(confirm_ns)
        self._unconfirmed = False
        self._started_ns: int | None = None
        # What was answered.
        self.alive = False
        self._answered_ns: int | None = None
        self._shown = 0
        self._fed: dict[int, int] = {}
        """Outputs that the board has confirmed to feed, and when."""
        self._milliamperes: dict[int, int] = {}
        self._rails: dict[int, tuple[int, ...]] = {}
        self._questions = BoardQuestions()
        self._errors = BoardErrors()
        self._seen_ns: dict[str, int] = {}
        """When each state that is reported once was last seen."""

    # ---- requests of the owner

    def want(self, servos: frozenset[int], number: int, now_ns: int) -> None:
        """From now on exactly these are to be fed. After `cut`, nothing until this was called with no servos.

        `number`: of this change of what is wanted, for `status`.
        """
        mask = self._mask(servos)
        self._begun, self._changes = True, number
        self._lost &= mask
        self._unknown &= mask
        if self._cut and mask:
            return
        self._cut = False
        if mask & ~self._wanted:
            self._on_until_ns = now_ns + REPEAT_FOR_NS
        self._wanted = mask
        if self._errors.due_ns is None:
            self._lost |= mask & self._errors.mask
        self._settle(now_ns)

    def cut(self, now_ns: int) -> None:
        """Nothing is to be fed, until `want` was called with no servos: a `want` of an earlier step gives nothing back.

        A mask leaves at once even if all is off already: the emergency stop is to be confirmed anew.
        """
        self._begun = self._cut = True
        self._wanted = self._unknown = 0
        self._unconfirmed = False
        self._settle(now_ns)
        self._anew(ALL, now_ns)

    def when_off(self, servos: frozenset[int], asked_ns: int, token: int, now_ns: int) -> None:
        """`news` gives a `Confirmed` with this token, `confirm_ns` after `asked_ns` at the latest."""
        mask = self._mask(servos)
        self._anew(mask & self._off.mask & ~self._off.unconfirmed, now_ns)
        self._repeat_until_ns = now_ns + REPEAT_FOR_NS  # also of what was given up
        self._off.wait(mask, asked_ns, token, self._number)

    def clear_errors(self, now_ns: int) -> None:
        """Delete all errors of the board, so that it feeds what it has blocked, once that is wanted anew."""
        self._errors.delete(now_ns)
        self._questions.doubles = 0  # somebody may have unplugged one of two boards
        self._seen_ns.clear()

    def not_sent(self, frames: Iterable[CanFrame], now_ns: int) -> None:
        """The interface has no room for these yet. Once there is room, the mask of that time leaves first."""
        for frame in frames:
            self._questions.not_sent(frame)
            if frame.id == SET_SUPPLY:
                self._anew(self._off.unconfirmed, now_ns)
                self._leave_ns = now_ns

    def opened(self, now_ns: int) -> None:
        """The interface was opened: nothing that was asked before is answered any more."""
        self._started_ns = now_ns if self._started_ns is None else self._started_ns
        self._questions.opened(now_ns)
        self._anew(self._off.unconfirmed, now_ns)

    def closed(self, why: str, now_ns: int) -> None:
        """The interface is gone, so the board is silent."""
        if self.alive:
            self._fall_silent(why, now_ns)

    # ---- what the owner reads

    @property
    def confirmed(self) -> bool:
        """Whether the board has confirmed that all is off which is to be off."""
        return self._begun and not self._off.unconfirmed and not self._errors.two_boards

    @property
    def status(self) -> Status:
        """What is known of the board now."""
        return Status(
            self.alive,
            self._named(self._shown),
            self.confirmed,
            self._named(self._lost),
            {self._servos[place]: why for place, why in self._errors.blocked.items()},
            self._named(sum(1 << place for place in self._fed)),
            self._changes,
            self._answered_ns,
            {self._servos[place]: ma for place, ma in self._milliamperes.items()},
            dict(self._rails),
        )

    def news(self) -> list[News | Confirmed]:
        """What has happened since the last call."""
        news = list(self._news)
        self._news.clear()
        return news

    # ---- received frames

    def receive(self, frame: CanFrame, now_ns: int) -> None:
        """A frame was on the bus; those that are not the board's, or are malformed, change nothing."""
        foreign = mask_of(frame) if frame.id == SET_SUPPLY else None
        if foreign is not None:
            self._meddled(foreign, now_ns)
        self._questions.asked_by_another(frame, now_ns)
        answer = read(frame)
        if answer is None:
            return
        if not self.alive:
            self.alive = True
            self._anew(self._off.unconfirmed, now_ns)
        self._answered_ns = now_ns
        self._questions.answered(now_ns)
        match answer:
            case Supplied(mask):
                self._answered_mask(mask, now_ns)
            case Currents(first, ma):
                self._milliamperes.update(zip(range(first - 1, first + 2), ma, strict=True))
            case Rails(question, values):
                self._rails[question] = values
                self._questions.answered_about_rails(CanFrame(question), now_ns)
                if self._questions.two_boards:
                    self._failed(BoardError(TWO_BOARDS), now_ns)
            case BoardError():
                self._failed(answer, now_ns)
            case NoError():
                self._errors.none_left()
            case Cleared():
                self._errors.deleted(now_ns)
            case OffPressed() | GoingOff():
                why = _OFF_PRESSED if isinstance(answer, OffPressed) else _GOING_OFF
                if self._begins(why, now_ns):
                    self._news.append(News(Kind.OFF_BUTTON, why))
        self.poll(now_ns)

    def poll(self, now_ns: int) -> None:
        """Find what time brings: a silent board, an unconfirmed off, the end of a wait. Every 10 ms at least."""
        if self._questions.silent(now_ns) and self.alive:
            self._fall_silent("the power board does not answer", now_ns)
        late, ended = self._off.late(now_ns)
        starts = self._started_ns is not None and now_ns - self._started_ns < START_NS
        if late and not self._unconfirmed and not starts:
            self._unconfirmed = True
            self._news.append(
                News(Kind.POWER_UNCONFIRMED, "the power board has not confirmed that these are off", self._named(late))
            )
        self._news += ended

    # ---- what is sent

    @property
    def due_ns(self) -> int:
        """When `next_frames` has something to send; it may have by then."""
        due_ns = (self._questions.due_ns, self._mask_due_ns(), self._errors.due_ns)
        return min(each for each in due_ns if each is not None)

    def next_frames(self, now_ns: int) -> list[CanFrame]:
        """What leaves now, in this order: masks first. They count as sent."""
        self.poll(now_ns)
        frames: list[CanFrame] = []
        mask_ns = self._mask_due_ns()
        if mask_ns is not None and now_ns >= mask_ns:
            frames.append(self._send(now_ns))
            if not self.confirmed or self._on_number == self._number:
                frames += self._questions.due_after(self._number, now_ns)
        # What is deleted before the board has the mask without it comes on again.
        without = self._off.have_reached(self._errors.mask, self._questions.reached)
        error_frame = self._errors.next_frame(now_ns, without=without)
        frames += [] if error_frame is None else [error_frame]
        if now_ns >= self._questions.due_ns:
            frames += self._questions.next(self._number, now_ns)
        return frames

    # ---- how

    def _mask(self, servos: frozenset[int]) -> int:
        return sum(self._bit[servo] for servo in servos)

    def _named(self, mask: int) -> frozenset[int]:
        return frozenset(servo for servo, bit in self._bit.items() if mask & bit)

    @property
    def _target(self) -> int:
        """The mask that the board is to have."""
        return self._wanted & ~self._lost & ~self._errors.mask

    def _settle(self, now_ns: int) -> None:
        """What is no longer to be fed goes off at once; what is, is no longer off."""
        target = self._target
        self._off.feed(target)
        self._anew(ALL & ~target & ~self._unknown & ~self._off.mask, now_ns)
        self._fed = {place: at_ns for place, at_ns in self._fed.items() if target >> place & 1}

    def _anew(self, mask: int, now_ns: int) -> None:
        """These are off, and are to be confirmed by a mask that is yet to be sent."""
        self._off.take(mask, self._number + 1, now_ns)
        if mask:
            self._repeat_until_ns = now_ns + REPEAT_FOR_NS
            self._leave_ns = now_ns

    def _mask_due_ns(self) -> int | None:
        """When the next mask is due; None: none is."""
        if not self._begun:
            return None
        due_ns = [] if self._leave_ns is None else [self._leave_ns]
        sent_ns = self._sent_ns or 0
        if not self.confirmed:
            # A repeat waits behind an answer, too: only the first mask has pins to switch.
            repeat_ns = max(sent_ns + REPEAT_NS, self._answer_ns + REST_NS)
            due_ns += [repeat_ns] if repeat_ns < self._repeat_until_ns else []
        target = self._target if self.alive else 0
        if self._next_on:
            due_ns.append(self._rest_ns)
        elif any(target >> place & 1 and place not in self._fed for place in range(OUTPUTS)):
            repeat_ns = max(sent_ns + REPEAT_ON_NS, self._rest_ns)
            due_ns += [repeat_ns] if repeat_ns < self._on_until_ns else []
        return min(due_ns, default=None)

    @property
    def _next_on(self) -> int:
        waits = not self.alive or (self._off.unconfirmed and not self._unconfirmed)
        on = 0 if waits else self._target & ~self._sent
        return next((on & six for six in _SIXES if on & six), 0)

    def _send(self, now_ns: int) -> CanFrame:
        """The mask as it may be now."""
        before = self._sent
        self._sent = before & self._target | (self._next_on if now_ns >= self._rest_ns else 0)
        self._number += 1
        if self._sent & ~before:
            self._on_number = self._number
        self._sent_ns = now_ns
        self._leave_ns = None
        steps = 1 + (self._sent & ~self._shown).bit_count()
        self._rest_ns = max(self._rest_ns, now_ns + steps * STEP_NS + REST_NS)
        return set_supply(self._sent)

    def _answered_mask(self, mask: int, now_ns: int) -> None:
        """6B: what the board feeds, as new as the newest mask and question that have reached it."""
        self._shown = mask
        self._answer_ns = now_ns
        # A mask that was on its way when this answer left it has an answer of its own.
        if self._sent_ns is None or now_ns - self._sent_ns > REST_NS:
            self._rest_ns = now_ns + REST_NS
        reached = NOTHING if self._errors.two_boards else self._questions.reached
        on_again, ended = self._off.answered(mask, reached, now_ns)
        self._news += ended
        self._anew(on_again, now_ns)
        gone = [
            place for place, at_ns in self._fed.items() if not mask >> place & 1 and at_ns < self._questions.reached_ns
        ]
        if gone:
            self._lose(sum(1 << place for place in gone), "the power board has switched these off by itself", now_ns)
        on = mask & self._target & self._sent if reached >= self._on_number else 0
        for place in range(OUTPUTS):
            if on >> place & 1 and place not in self._fed:
                self._fed[place] = now_ns
                self._milliamperes.pop(place, None)  # measured before it was fed
        if self.confirmed:
            self._unconfirmed = False

    def _lose(self, mask: int, why: str, now_ns: int, *, report: bool = True) -> None:
        """These are off, and not by us: they stay off until they are wanted anew."""
        self._lost |= mask & self._wanted
        self._settle(now_ns)
        if report:
            self._news.append(News(Kind.POWER_FAULT, why, self._named(mask)))

    def _failed(self, error: BoardError, now_ns: int) -> None:
        """65: the board has blocked servos or converters, and leaves them so until the error is deleted."""
        why, mask, new = self._errors.shown(error, now_ns)
        begins = self._begins(f"{why} {error.mask}", now_ns)
        if mask or (new and begins):
            self._lose(mask, why, now_ns, report=new and begins)

    def _meddled(self, mask: int, now_ns: int) -> None:
        """Another node has sent this mask: ours follows, without what that one took, also where ours still waits."""
        taken = self._target & ~mask
        self._lost |= taken
        self._settle(now_ns)
        if self._begun:
            self._anew(mask & ~self._target & ~self._unknown, now_ns)
            self._repeat_until_ns = now_ns + REPEAT_FOR_NS
            # Our own masks never wait; answers to a node that floods the bus do.
            self._leave_ns = max(now_ns, (self._sent_ns or 0) + REST_NS)
        why = "another program switches servos through the power board"
        if self._begins(why, now_ns):
            self._news.append(News(Kind.POWER_FAULT, why, self._named(taken)))

    def _begins(self, state: str, now_ns: int) -> bool:
        """Whether a state that is seen now is to be reported: it had ended, or a reset came since it was reported."""
        seen_ns, self._seen_ns[state] = self._seen_ns.get(state), now_ns
        return seen_ns is None or now_ns - seen_ns >= LASTS_NS

    def _fall_silent(self, why: str, now_ns: int) -> None:
        """The board may have started anew, with all off: what was fed counts as lost."""
        self.alive = False
        target = self._target
        self._unknown |= target
        self._lost |= target
        self._sent = 0
        self._fed.clear()
        self._milliamperes.clear()
        self._settle(now_ns)
        self._news.append(News(Kind.POWER_UNCONFIRMED, why, self._named(target)))
