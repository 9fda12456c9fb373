"""Decides which frames the power board gets and when, and what its answers mean. No I/O, no clock.

- **Off** is sent at once, and every 20 ms until it is confirmed, for 3 s.
- **On** waits until each off is confirmed or late, and until the board's counter is at rest, 5 ms after its answer. Six
  outputs go on at a time: the board answers once all are on. On is sent only while the board answers, since the queue
  of a broken link could deliver it later.
- **Confirmed** means an answer 6B given after the mask had reached the board (offs.py). The board answers questions in
  its receive interrupt, and masks later. So the 6B must follow the answer to a question sent after the mask
  (questions.py).
- **No output comes on unasked.** A board whose error is deleted powers all of its last mask again. So masks leave out
  outputs that the board has blocked, that another node has cut, or that were off after a silence, until the owner has
  dropped their servos once and wants them again.
"""

from collections import deque
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Final, NamedTuple

from gateway.allowance import NS_PER_MS
from gateway.model import power_board
from gateway.model.power_board import BoardError, BoardNotice, CanFrame, Currents, Rails, Supplied
from gateway.robot.power.errors import BoardErrors
from gateway.robot.power.offs import Confirmed, OutputsOff
from gateway.robot.power.questions import BoardQuestions
from schemas.telemetry import Kind

REPEAT_NS: Final = 20 * NS_PER_MS
"""The period of masks until each off is confirmed."""
START_NS: Final = 1000 * NS_PER_MS
"""After the first opening, no missing confirmation is reported for this long: a starting gateway delays its threads."""
REPEAT_FOR_NS: Final = 3000 * NS_PER_MS
"""Longer than questions.FORGOTTEN_NS: until then, a link that lost six questions confirms nothing."""
REPEAT_ON_NS: Final = 100 * NS_PER_MS  # mutants accepted (Mul_Div, Step): none is the only right one
"""The period of masks until each on is confirmed, once the first answer is overdue."""
REST_NS: Final = 5 * NS_PER_MS  # mutants accepted (Step): none is the only right one
"""After an answer 6B, the board's counter is one too far for a pass of its loop, 2 ms at most."""
STEP_NS: Final = 54 * NS_PER_MS  # mutants accepted (Step): none is the only right one
"""The longest time for 27 passes of the board's loop, one for the answer and one for each output that goes on."""
LASTS_NS: Final = 1000 * NS_PER_MS
"""A state that is reported once has ended after this long without its frames; the next frame reports it again."""

_OFF_PRESSED: Final = "somebody pressed the power board's off button"
_GOING_OFF: Final = "somebody has asked the power board to switch the whole robot off, and it does so in 1 s"
_AT_ONCE: Final = 6
"""Outputs that go on at a time."""
_NONE: Final = frozenset[int]()
NOTHING: Final = -1
"""Smaller than every mask's number."""


class News(NamedTuple):
    """An event to publish: kind, sentence, and the servos concerned."""

    kind: Kind
    detail: str
    servos: frozenset[int] = frozenset()


class Status(NamedTuple):
    """The board's state at one time. Servos by their ids."""

    alive: bool = False
    supplied: frozenset[int] = frozenset()
    """The servos powered by the board's last answer."""
    confirmed: bool = False
    """Whether the board has confirmed every off."""
    lost: frozenset[int] = frozenset()
    """Wanted but not powered, though the gateway has not cut them."""
    refused: Mapping[int, str] = {}
    """The servos that the board blocks, and why."""
    fed: frozenset[int] = frozenset()
    """Confirmed to be powered since they were last wanted."""
    changes: int = 0
    """The number of the newest `want`."""
    answered_ns: int | None = None
    currents_ma: Mapping[int, int] = {}
    """The current of each servo, if measured since the board answers."""
    rails: Mapping[int, tuple[int, ...]] = {}
    """The newest answers about rails, by the question's identifier, in mA, mV and °C."""


class PowerBoard:
    """One board, used by one thread at a time. All times are of one monotonic clock, in ns."""

    # mutants accepted (Delete_USub, Forget, Step): set before it is read
    def __init__(self, outputs: Sequence[int], *, confirm_ns: int) -> None:
        """`outputs` are the servos on outputs 1, 2 …. An off that is not confirmed within `confirm_ns` is reported."""
        self._servos = tuple(outputs)
        self._news: deque[News | Confirmed] = deque()
        # The wanted state. Nothing is sent before the first `want` or `cut`.
        self._begun = self._cut = False
        self._changes = 0
        self._wanted = self._lost = _NONE
        self._unknown = _NONE
        """Lost to a silence: perhaps still powered, for landing. Only the owner's wish puts them off in a mask."""
        # The sent state. A restarted board powers nothing, which is mask 0, too.
        self._sent = _NONE
        self._number = self._on_number = 0
        """The number of the newest mask, and of the newest one that switches an output on."""
        self._sent_ns: int | None = None
        self._leave_ns: int | None = None
        self._repeat_until_ns = 0
        self._answer_ns = -REST_NS
        """When the board last sent its mask."""
        self._rest_ns = 0
        """When the board's counter comes to rest."""
        self._on_until_ns = 0
        self._off = OutputsOff(confirm_ns)
        self._unconfirmed = False
        self._started_ns: int | None = None
        # The answered state.
        self.alive = False
        self._answered_ns: int | None = None
        self._shown = _NONE
        self._fed: dict[int, int] = {}
        """When each servo was confirmed to be powered since it was last wanted."""
        self._milliamperes: dict[int, int] = {}
        self._rails: dict[int, tuple[int, ...]] = {}
        self._questions = BoardQuestions()
        self._errors = BoardErrors()
        self._seen_ns: dict[str, int] = {}
        """When each state that is reported once was last seen."""

    # ---- requests of the owner

    def want(self, servos: frozenset[int], number: int, now_ns: int) -> None:
        """Power exactly these servos from now on. After `cut`, call it without servos first.

        `number` numbers this change, for `status`.
        """
        self._begun, self._changes = True, number
        self._lost &= servos
        self._unknown &= servos
        if self._cut and servos:
            return
        self._cut = False
        if servos - self._wanted:
            self._on_until_ns = now_ns + REPEAT_FOR_NS
        self._wanted = servos
        if self._errors.due_ns is None:
            self._lost |= servos & self._blocked
        self._settle(now_ns)

    def cut(self, now_ns: int) -> None:
        """Cut all power, until `want` is called without servos: a `want` of an earlier step restores nothing.

        A mask leaves at once even if all is off, so that the board confirms the emergency stop.
        """
        self._begun = self._cut = True
        self._wanted = self._unknown = _NONE
        self._unconfirmed = False
        self._settle(now_ns)
        self._anew(self._servos, now_ns)

    def when_off(self, servos: frozenset[int], asked_ns: int, token: int, now_ns: int) -> None:
        """Have `news` return a `Confirmed` with this token, `confirm_ns` after `asked_ns` at the latest."""
        self._anew(servos & self._off.servos - self._off.unconfirmed, now_ns)
        self._repeat_until_ns = now_ns + REPEAT_FOR_NS  # also of masks that were given up
        self._off.wait(servos, asked_ns, token, self._number)

    def clear_errors(self, now_ns: int) -> None:
        """Delete all errors of the board, so that it powers blocked servos once they are wanted again."""
        self._errors.delete(now_ns)
        self._questions.doubles = 0  # one of two boards may have been unplugged
        self._seen_ns.clear()

    def not_sent(self, frames: Iterable[CanFrame], now_ns: int) -> None:
        """Record that the interface had no room for these frames. Once it has, the latest mask leaves first."""
        for frame in frames:
            self._questions.not_sent(frame)
            if frame.id == power_board.SET_SUPPLY:
                self._anew(self._off.unconfirmed, now_ns)
                self._leave_ns = now_ns

    def opened(self, now_ns: int) -> None:
        """Record that the interface was opened. Earlier questions get no answer any more."""
        self._started_ns = now_ns if self._started_ns is None else self._started_ns
        self._questions.opened(now_ns)
        self._anew(self._off.unconfirmed, now_ns)

    def closed(self, why: str, now_ns: int) -> None:
        """Record that the interface is gone, which makes the board silent."""
        if self.alive:
            self._fall_silent(why, now_ns)

    # ---- what the owner reads

    @property
    def confirmed(self) -> bool:
        """Whether the board has confirmed every off."""
        return self._begun and not self._off.unconfirmed and not self._errors.two_boards

    @property
    def status(self) -> Status:
        return Status(
            self.alive,
            self._shown,
            self.confirmed,
            self._lost,
            {self._servos[place]: why for place, why in self._errors.blocked.items()},
            frozenset(self._fed),
            self._changes,
            self._answered_ns,
            dict(self._milliamperes),
            dict(self._rails),
        )

    def news(self) -> list[News | Confirmed]:
        """Return the events since the last call."""
        news = list(self._news)
        self._news.clear()
        return news

    # ---- received frames

    # mutants accepted (Forget): a mask is read as no answer; only time is lost
    def receive(self, frame: CanFrame, now_ns: int) -> None:
        """Take a frame from the bus. Malformed frames, and frames of no concern, change nothing."""
        foreign = power_board.mask_of(frame) if frame.id == power_board.SET_SUPPLY else None
        if foreign is not None:
            self._meddled(self._named(foreign), now_ns)
        self._questions.asked_by_another(frame, now_ns)
        answer = power_board.read(frame)
        if answer is None:
            return
        if not self.alive:
            self.alive = True
            self._anew(self._off.unconfirmed, now_ns)
        self._answered_ns = now_ns
        self._questions.answered(now_ns)
        match answer:
            case Supplied(mask):
                self._answered_mask(self._named(mask), now_ns)
            case Currents(first, ma):
                self._milliamperes.update(zip(self._servos[first - 1 : first + 2], ma, strict=True))
            case Rails(question, values):
                self._rails[question] = values
                self._questions.answered_about_rails(CanFrame(question), now_ns)
                if self._questions.two_boards:
                    self._failed(BoardError(power_board.TWO_BOARDS), now_ns)
            case BoardError():
                self._failed(answer, now_ns)
            case BoardNotice.NO_ERROR:
                self._errors.none_left()
            case BoardNotice.CLEARED:
                self._errors.deleted(now_ns)
            case BoardNotice.OFF_PRESSED | BoardNotice.GOING_OFF:
                why = _OFF_PRESSED if answer is BoardNotice.OFF_PRESSED else _GOING_OFF
                if self._begins(why, now_ns):
                    self._news.append(News(Kind.OFF_BUTTON, why))
        self.poll(now_ns)

    def poll(self, now_ns: int) -> None:  # mutants accepted (Lt_LtE): equal times
        """Detect a silent board, an unconfirmed off, the end of a wait. Call it every 10 ms at least."""
        if self._questions.silent(now_ns) and self.alive:
            self._fall_silent("the power board does not answer", now_ns)
        late, ended = self._off.late(now_ns)
        starts = self._started_ns is not None and now_ns - self._started_ns < START_NS
        if late and not self._unconfirmed and not starts:
            self._unconfirmed = True
            self._news.append(
                News(Kind.POWER_UNCONFIRMED, "the power board has not confirmed that these are off", late)
            )
        self._news += ended

    # ---- what is sent

    @property
    def due_ns(self) -> int:  # mutants accepted (LeaveOut): only time is lost
        """When to call `next_frames` next."""
        due_ns = (self._questions.due_ns, self._mask_due_ns(), self._errors.due_ns)
        return min(each for each in due_ns if each is not None)

    def next_frames(self, now_ns: int) -> list[CanFrame]:  # mutants accepted (Forget): only time is lost
        """Return the frames to send now, in this order. They count as sent."""
        self.poll(now_ns)
        frames: list[CanFrame] = []
        mask_ns = self._mask_due_ns()
        if mask_ns is not None and now_ns >= mask_ns:
            frames.append(self._send(now_ns))
            if not self.confirmed or self._on_number == self._number:
                frames += self._questions.due_after(self._number, now_ns)
        # An output whose error is deleted before the board has a mask without it would come on again.
        without = self._off.have_reached(self._blocked, self._questions.reached)
        error_frame = self._errors.next_frame(now_ns, without=without)
        frames += [] if error_frame is None else [error_frame]
        if now_ns >= self._questions.due_ns:
            frames += self._questions.next(self._number, now_ns)
        return frames

    # ---- how

    def _named(self, mask: int) -> frozenset[int]:
        return frozenset(servo for place, servo in enumerate(self._servos) if mask >> place & 1)

    @property
    def _blocked(self) -> frozenset[int]:
        return self._named(self._errors.mask)

    @property
    def _target(self) -> frozenset[int]:
        return self._wanted - self._lost - self._blocked

    def _settle(self, now_ns: int) -> None:
        """Apply a changed target: outputs that left it go off at once."""
        target = self._target
        self._off.feed(target)
        self._anew({*self._servos} - target - self._unknown - self._off.servos, now_ns)
        self._fed = {servo: at_ns for servo, at_ns in self._fed.items() if servo in target}

    def _anew(self, servos: Collection[int], now_ns: int) -> None:
        """Have these servos confirmed off, by a mask that is sent next."""
        self._off.take(servos, self._number + 1, now_ns)
        if servos:
            self._repeat_until_ns = now_ns + REPEAT_FOR_NS
            self._leave_ns = now_ns

    def _mask_due_ns(self) -> int | None:  # mutants accepted (Add_Sub, Lt_LtE, Step): equal times; only time is lost
        if not self._begun:
            return None
        due_ns = [] if self._leave_ns is None else [self._leave_ns]
        sent_ns = self._sent_ns or 0
        if not self.confirmed:
            # A repeat waits for the board's rest, since only the first mask has pins to switch.
            repeat_ns = max(sent_ns + REPEAT_NS, self._answer_ns + REST_NS)
            due_ns += [repeat_ns] if repeat_ns < self._repeat_until_ns else []
        if self._next_on:
            due_ns.append(self._rest_ns)
        elif self.alive and self._target - self._fed.keys():
            repeat_ns = max(sent_ns + REPEAT_ON_NS, self._rest_ns)
            due_ns += [repeat_ns] if repeat_ns < self._on_until_ns else []
        return min(due_ns, default=None)

    @property
    def _next_on(self) -> frozenset[int]:
        waits = not self.alive or (self._off.unconfirmed and not self._unconfirmed)
        on = _NONE if waits else self._target - self._sent
        parts = (on.intersection(self._servos[at : at + _AT_ONCE]) for at in range(0, len(self._servos), _AT_ONCE))
        return next(filter(None, parts), _NONE)

    def _send(self, now_ns: int) -> CanFrame:  # mutants accepted (Add_Sub, Step): any numbers that grow; slack
        """Return the mask to send now, and count it as sent."""
        before = self._sent
        self._sent = before & self._target | (self._next_on if now_ns >= self._rest_ns else _NONE)
        self._number += 1
        if self._sent - before:
            self._on_number = self._number
        self._sent_ns = now_ns
        self._leave_ns = None
        steps = 1 + len(self._sent - self._shown)
        self._rest_ns = max(self._rest_ns, now_ns + steps * STEP_NS + REST_NS)
        return power_board.set_supply(
            sum(1 << place for place, servo in enumerate(self._servos) if servo in self._sent)
        )

    # mutants accepted (Gt_GtE, Lt_LtE): equal times
    def _answered_mask(self, shown: frozenset[int], now_ns: int) -> None:
        """Take an answer 6B: the servos that the board powers, after the masks that have reached it."""
        self._shown = shown
        self._answer_ns = now_ns
        # A mask that was on its way when this answer left will get its own answer.
        if self._sent_ns is None or now_ns - self._sent_ns > REST_NS:
            self._rest_ns = now_ns + REST_NS
        reached = NOTHING if self._errors.two_boards else self._questions.reached
        on_again, ended = self._off.answered(shown, reached, now_ns)
        self._news += ended
        self._anew(on_again, now_ns)
        gone = {
            servo for servo, at_ns in self._fed.items() if servo not in shown and at_ns < self._questions.reached_ns
        }
        if gone:
            self._lose(frozenset(gone), "the power board has switched these off by itself", now_ns)
        if reached >= self._on_number:
            for servo in shown & self._target & self._sent - self._fed.keys():
                self._fed[servo] = now_ns
                self._milliamperes.pop(servo, None)  # measured before the output was on
        if self.confirmed:
            self._unconfirmed = False

    def _lose(self, servos: frozenset[int], why: str, now_ns: int, *, report: bool = True) -> None:
        """Record servos that went off by another cause. They stay off until they are wanted again."""
        self._lost |= servos & self._wanted
        self._settle(now_ns)
        if report:
            self._news.append(News(Kind.POWER_FAULT, why, servos))

    def _failed(self, error: BoardError, now_ns: int) -> None:
        """Take an answer 65: the board has blocked servos or converters until the error is deleted."""
        why, mask, new = self._errors.shown(error, now_ns)
        begins = self._begins(f"{why} {error.mask}", now_ns)
        if mask or (new and begins):
            self._lose(self._named(mask), why, now_ns, report=new and begins)

    # mutants accepted (Forget, Step): else a repeat follows
    def _meddled(self, theirs: frozenset[int], now_ns: int) -> None:
        """Answer another node's mask with ours, without the servos that it cut, even those still waiting for on."""
        taken = self._target - theirs
        self._lost |= taken
        self._settle(now_ns)
        if self._begun:
            self._anew(theirs - self._target - self._unknown, now_ns)
            self._repeat_until_ns = now_ns + REPEAT_FOR_NS
            # Unlike our own masks, answers to another node wait: it may flood the bus.
            self._leave_ns = max(now_ns, (self._sent_ns or 0) + REST_NS)
        why = "another program switches servos through the power board"
        if self._begins(why, now_ns):
            self._news.append(News(Kind.POWER_FAULT, why, taken))

    def _begins(self, state: str, now_ns: int) -> bool:
        """Return whether to report a state seen now: it is new, had ended, or there was a reset since."""
        seen_ns, self._seen_ns[state] = self._seen_ns.get(state), now_ns
        return seen_ns is None or now_ns - seen_ns >= LASTS_NS

    # mutants accepted (Forget, Step): either forgets what was fed
    def _fall_silent(self, why: str, now_ns: int) -> None:
        """Record a silent board. It may have restarted with all off, so all powered servos count as lost."""
        self.alive = False
        target = self._target
        self._unknown |= target
        self._lost |= target
        self._sent = _NONE
        self._fed.clear()
        self._milliamperes.clear()
        self._settle(now_ns)
        self._news.append(News(Kind.POWER_UNCONFIRMED, why, target))
