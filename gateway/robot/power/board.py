"""Decides which frames the power board gets and when, and what its answers mean. No I/O, no clock.

- **Off** is sent at once, and every 20 ms until it is confirmed, for 3 s.
- **On** waits until each off is confirmed or late, and until the board's counter is at rest, 5 ms after its answer. Six
  outputs go on at a time: the board answers once all are on. On is sent only while the board answers, since the queue
  of a broken link could deliver it later.
- **Confirmed** means an answer 6B that shows the servos off, given after the mask had reached the board. The board
  answers questions in its receive interrupt, and masks later. So the 6B must follow the answer to a question sent after
  the mask (questions.py). Masks have numbers for this.
- **No output comes on unasked.** A board whose error is deleted powers all of its last mask again. So masks leave out
  outputs that the board has blocked, that another node has cut, or that were off after a silence, until the owner has
  dropped their servos once and wants them again.
"""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from typing import Final, Literal, NamedTuple

from gateway.model.power_board import (
    ASK_CURRENTS,
    CLEAR_ERROR,
    GOING_OFF,
    OFF_PRESSED,
    SET_SUPPLY,
    BoardError,
    BoardValues,
    CanFrame,
    mask_of,
    read,
    set_supply,
)
from gateway.rate_limit import NS_PER_MS
from gateway.robot.power.questions import BoardErrors, BoardQuestions

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

_OFF: Final = {
    OFF_PRESSED: "somebody pressed the power board's off button",
    GOING_OFF: "somebody has asked the power board to switch the whole robot off, and it does so in 1 s",
}
_TWO: Final = "two power boards answer on this bus; unplug one of them, and reset"
_AT_ONCE: Final = 6
"""Outputs that go on at a time."""
_NONE: Final = frozenset[int]()


Then = Callable[[float | None], None]
"""The owner calls it once: how many ms after the Stop was received the board has confirmed it; None: it has not."""
_Kind = Literal["off_button", "power_fault", "power_unconfirmed"]


class News(NamedTuple):
    """An event to publish: its kind, a sentence, and the servos concerned."""

    kind: _Kind
    detail: str
    servos: frozenset[int] = frozenset()


class Confirmed(NamedTuple):
    """The answer to a `when_off`, to be called with `ms`."""

    then: Then
    ms: float | None


class _Off(NamedTuple):
    """An off that is not confirmed: the number of the first mask for it, and since when."""

    number: int
    since_ns: int


class _Wait(NamedTuple):
    """A request that waits until these servos are confirmed off, by mask number `number` or later."""

    then: Then
    servos: frozenset[int]
    asked_ns: int
    number: int


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
    """The servos that stay off until `clear_errors`, and why."""
    fed: frozenset[int] = frozenset()
    """Confirmed to be powered since they were last wanted."""
    changes: int = 0  # mutants accepted (Step): nothing is fed
    """The number of the newest `want`."""
    taken: frozenset[int] = frozenset()
    """Those of `lost` that another node, or the board by itself, has switched off; the others are lost to a silence, or
    blocked."""
    answered_ns: int | None = None
    currents_ma: Mapping[int, int] = {}
    """The current of each servo, if measured since the board answers."""
    rails: Mapping[int, tuple[int, ...]] = {}
    """The newest answers about rails, by the question's identifier, in mA, mV and °C."""


class PowerBoard:
    """One board, used by one thread at a time. All times are of one monotonic clock, in ns."""

    # mutants accepted (Forget, Step): set before it is read
    def __init__(self, outputs: Sequence[int], *, confirm_ns: int) -> None:
        """`outputs` are the servos on outputs 1, 2 …. An off that is not confirmed within `confirm_ns` is reported."""
        self._servos = tuple(outputs)
        self._confirm_ns = confirm_ns
        self.news: list[News | Confirmed] = []
        """The events since the owner last emptied it."""
        # The wanted state.
        self._cut = False
        self._changes = 0
        self._wanted = self._lost = self._taken = _NONE
        self._unknown = _NONE
        """Lost to a silence: perhaps still powered, for landing. Only the owner's wish puts them off in a mask."""
        self._kept = frozenset(outputs)
        """The servos that need not be off."""
        # The sent state. A restarted board powers nothing, which is mask 0, too.
        self._sent = _NONE
        self._number = 0
        """The number of the newest mask."""
        self._sent_ns = 0
        self._leave_ns: int | None = None
        self._repeat_until_ns = 0
        self._answer_ns = 0
        """When the board last sent its mask."""
        self._rest_ns = 0
        """When the board's counter comes to rest."""
        self._offs: dict[int, _Off] = {}
        """Each servo that has to be off and is not confirmed."""
        self._waits: list[_Wait] = []
        self._unconfirmed = False
        """Whether a missing confirmation was reported."""
        self._reports_ns = 0
        """From when on a missing confirmation is reported."""
        # The answered state.
        self.alive = False
        self._shown = _NONE
        self._fed: dict[int, int] = {}
        """When each servo was confirmed to be powered since it was last wanted."""
        self._milliamperes: dict[int, int] = {}
        self._rails: dict[int, tuple[int, ...]] = {}
        self._questions = BoardQuestions()
        self._errors = BoardErrors()
        self._seen_ns: dict[object, int] = {}
        """When each state that is reported once was last seen."""

    # ---- requests of the owner

    def want(self, servos: frozenset[int], number: int, now_ns: int) -> None:
        """Power exactly these servos from now on. After `cut`, call it without servos first.

        `number` numbers this change, for `status`.
        """
        self._changes = number
        self._lost = servos & (self._lost | self._refused.keys())
        self._taken &= servos
        self._unknown &= servos
        if self._cut and servos:
            return
        self._cut = False
        self._wanted = servos
        self._settle(now_ns)

    def cut(self, now_ns: int) -> None:
        """Cut all power, until `want` is called without servos: a `want` of an earlier step restores nothing.

        A mask leaves at once even if all is off, so that the board confirms the emergency stop.
        """
        self._cut = True
        self._wanted = self._unknown = _NONE
        self._unconfirmed = False
        self._settle(now_ns)
        self._anew(self._servos, now_ns)

    def when_off(self, servos: frozenset[int], asked_ns: int, then: Then, now_ns: int) -> None:
        """Have `news` get a `Confirmed` with `then`, `confirm_ns` after `asked_ns` at the latest."""
        self._anew(servos - self._kept - self._offs.keys(), now_ns)
        self._repeat_until_ns = now_ns + REPEAT_FOR_NS  # also of masks that were given up
        self._waits.append(_Wait(then, servos, asked_ns, self._cut_by(servos, self._number)))

    def clear_errors(self, now_ns: int) -> None:
        """Delete all errors of the board, so that it powers blocked servos once they are wanted again.

        Their outputs come on if the board's newest mask has them, which may be another node's. So ours is sent anew.
        """
        self._anew(frozenset(self._servos) - self._kept, now_ns)
        self._errors.delete(now_ns)
        # mutants accepted (Step): one more answer ends a row, too
        self._questions.doubles = 0  # one of two boards may have been unplugged
        self._seen_ns.clear()

    def not_sent(self, frames: Iterable[CanFrame], now_ns: int) -> None:
        """Record that the interface had no room for these frames. Once it has, the latest mask leaves first."""
        for frame in frames:
            self._questions.asked.pop(frame, None)
            if frame.id == SET_SUPPLY:
                self._leave_ns = now_ns

    def opened(self, now_ns: int) -> None:
        """Record that the interface was opened, which may have lost masks."""
        self._reports_ns = self._reports_ns or now_ns + START_NS
        self._anew(tuple(self._offs), now_ns)

    # mutants accepted (Forget, Step): either forgets what was fed
    def fall_silent(self, why: str, now_ns: int) -> None:
        """Record a silent board. It may have restarted with all off, so all powered servos count as lost."""
        if not self.alive:
            return
        self.alive = False
        self._unknown |= self._target
        self._sent = _NONE
        self._milliamperes.clear()
        self._lose(self._target, why, now_ns, "power_unconfirmed")

    # ---- what the owner reads

    @property
    def confirmed(self) -> bool:
        """Whether the board has confirmed every off."""
        return not self._offs and not self._questions.two_boards

    @property
    def status(self) -> Status:
        return Status(
            self.alive,
            self._shown,
            self.confirmed,
            self._lost,
            self._refused,
            frozenset(self._fed),
            self._changes,
            self._taken,
            self._questions.answered_ns,
            dict(self._milliamperes),
            dict(self._rails),
        )

    # ---- received frames

    # mutants accepted (Forget): a mask is read as no answer; only time is lost
    def receive(self, frame: CanFrame, now_ns: int) -> None:
        """Take a frame from the bus. Malformed frames, and frames of no concern, change nothing."""
        foreign = mask_of(frame) if frame.id == SET_SUPPLY else None
        if foreign is not None:
            self._meddled(self._named(foreign), now_ns)
        self._questions.asked_by_another(frame, now_ns)
        answer = read(frame)
        if answer is None:
            return
        if not self.alive:
            self.alive = True
            self._anew(tuple(self._offs), now_ns)
        self._questions.answered(now_ns)
        match answer:
            case int(mask):
                self._answered_mask(self._named(mask), now_ns)
            case BoardValues(identifier, values):
                self._measured(CanFrame(identifier), values, now_ns)
            case BoardError(code, why, outputs):
                servos = self._named(outputs)
                self._errors.shown(code, dict.fromkeys(servos, why), now_ns)
                self._lose(servos, why, now_ns, "power_fault" if self._begins(answer, now_ns) else None)
            case CanFrame(0x65):
                self._errors.none_left()
            case CanFrame(0x97):
                self._errors.deleted(now_ns)
            case CanFrame(identifier):
                if self._begins(answer, now_ns):
                    self.news.append(News("off_button", _OFF[identifier]))

    def poll(self, now_ns: int) -> None:  # mutants accepted (GtE_Gt): equal times
        """Detect a silent board, an unconfirmed off, the end of a wait. Call it every 10 ms at least."""
        if self._questions.silent(now_ns):
            self.fall_silent("the power board does not answer", now_ns)
        late = frozenset(servo for servo, off in self._offs.items() if now_ns - off.since_ns >= self._confirm_ns)
        if late and not self._unconfirmed and now_ns >= self._reports_ns:
            self._unconfirmed = True
            why = "the power board has not confirmed that these are off"
            self.news.append(News("power_unconfirmed", why, late))
        for wait in [each for each in self._waits if now_ns - each.asked_ns >= self._confirm_ns]:
            self._waits.remove(wait)
            self.news.append(Confirmed(wait.then, None))

    # ---- what is sent

    @property
    def due_ns(self) -> int:  # mutants accepted (LeaveOut): only time is lost
        """When to call `next_frames` next."""
        due_ns = (self._questions.due_ns, self._mask_due_ns(), self._errors.due_ns)
        return min(each for each in due_ns if each is not None)

    def next_frames(self, now_ns: int) -> list[CanFrame]:
        """Return the frames to send now, in this order. They count as sent."""
        frames: list[CanFrame] = []
        mask_ns = self._mask_due_ns()
        if mask_ns is not None and now_ns >= mask_ns:
            frames = [self._send(now_ns), *self._questions.about_rails(self._number, now_ns)]
        # An output whose error is deleted before the board has a mask without it would come on again.
        reached = self._questions.reached
        without = self._cut_by(self._refused, reached) <= reached
        errors = self._errors.next_frames(now_ns, without=without)
        if CLEAR_ERROR in errors and not frames:
            frames = [self._send(now_ns)]
        frames += errors
        if now_ns >= self._questions.due_ns:
            frames += self._questions.next(self._number, now_ns)
        return frames

    # ---- how

    def _named(self, mask: int) -> frozenset[int]:
        return frozenset(servo for place, servo in enumerate(self._servos) if mask >> place & 1)

    @property
    def _refused(self) -> dict[int, str]:
        return dict.fromkeys(self._servos, _TWO) if self._questions.two_boards else self._errors.blocked

    @property
    def _target(self) -> frozenset[int]:
        return self._wanted - self._lost

    def _settle(self, now_ns: int) -> None:
        """Apply a changed target: outputs that left it go off at once."""
        target = self._target
        before, self._kept = self._kept, target | self._unknown
        self._offs = {servo: off for servo, off in self._offs.items() if servo not in target}
        self._anew(before - self._kept, now_ns)
        self._fed = {servo: at_ns for servo, at_ns in self._fed.items() if servo in target}

    def _anew(self, servos: Collection[int], now_ns: int) -> None:
        """Have these servos confirmed off, by a mask that is sent next."""
        for servo in servos:
            off = self._offs.get(servo)
            self._offs[servo] = _Off(self._number + 1, now_ns if off is None else off.since_ns)
        if servos:
            self._repeat_until_ns = now_ns + REPEAT_FOR_NS
            self._leave_ns = now_ns

    def _cut_by(self, servos: Collection[int], default: int) -> int:
        """Return the number of the mask that cuts the last of these servos, or `default` if all offs are confirmed."""
        return max((off.number for servo, off in self._offs.items() if servo in servos), default=default)

    def _mask_due_ns(self) -> int | None:  # mutants accepted (Add_Sub, Lt_LtE, Step): equal times; only time is lost
        due_ns = [] if self._leave_ns is None else [self._leave_ns]
        if not self.confirmed:
            # A repeat waits for the board's rest, since only the first mask has pins to switch.
            repeat_ns = max(self._sent_ns + REPEAT_NS, self._answer_ns + REST_NS)
            due_ns += [repeat_ns] if repeat_ns < self._repeat_until_ns else []
        if self._next_on:
            due_ns.append(self._rest_ns)
        elif self.alive and self._target - self._fed.keys():
            due_ns.append(max(self._sent_ns + REPEAT_ON_NS, self._rest_ns))
        return min(due_ns, default=None)

    @property
    def _next_on(self) -> frozenset[int]:
        waits = not self.alive or (self._offs and not self._unconfirmed)
        on = _NONE if waits else self._target - self._sent
        return frozenset([servo for servo in self._servos if servo in on][:_AT_ONCE])

    def _send(self, now_ns: int) -> CanFrame:  # mutants accepted (Add_Sub, Step): any numbers that grow; slack
        """Return the mask to send now, and count it as sent."""
        self._sent = self._sent & self._target | (self._next_on if now_ns >= self._rest_ns else _NONE)
        self._number += 1
        self._sent_ns = now_ns
        self._leave_ns = None
        steps = 1 + len(self._sent - self._shown)
        self._rest_ns = max(self._rest_ns, now_ns + steps * STEP_NS + REST_NS)
        return set_supply(sum(1 << place for place, servo in enumerate(self._servos) if servo in self._sent))

    # mutants accepted (Gt_GtE, Lt_LtE): equal times
    def _answered_mask(self, shown: frozenset[int], now_ns: int) -> None:
        """Take an answer 6B: the servos that the board powers, after the masks that have reached it."""
        self._shown = shown
        self._answer_ns = now_ns
        # A mask that was on its way when this answer left will get its own answer.
        if now_ns - self._sent_ns > REST_NS:
            self._rest_ns = now_ns + REST_NS
        # mutants accepted (Step): a number below all masks'
        reached = 0 if self._questions.doubles else self._questions.reached  # another board may have answered
        on_again = shown - self._kept - self._offs.keys()
        self._offs = {each: off for each, off in self._offs.items() if each in shown or off.number > reached}
        for wait in [each for each in self._waits if each.number <= reached and shown.isdisjoint(each.servos)]:
            self._waits.remove(wait)
            self.news.append(Confirmed(wait.then, (now_ns - wait.asked_ns) / NS_PER_MS))
        self._anew(on_again, now_ns)
        gone = {
            servo for servo, at_ns in self._fed.items() if servo not in shown and at_ns < self._questions.reached_ns
        }
        if gone:
            self._lose(frozenset(gone), "the power board has switched these off by itself", now_ns, taken=True)
        if reached == self._number:
            for servo in shown & self._target & self._sent - self._fed.keys():
                self._fed[servo] = now_ns
                self._milliamperes.pop(servo, None)  # measured before the output was on
        if self.confirmed:
            self._unconfirmed = False

    def _measured(self, question: CanFrame, values: tuple[int, ...], now_ns: int) -> None:
        if question in ASK_CURRENTS:
            first = len(values) * ASK_CURRENTS.index(question)
            self._milliamperes.update(zip(self._servos[first:], values, strict=False))
        else:
            self._rails[question.id] = values
            before = self._questions.two_boards
            self._questions.answered_about_rails(question, now_ns)
            if self._questions.two_boards and not before:
                self._lose(frozenset(self._servos), _TWO, now_ns)

    def _lose(
        self,
        servos: frozenset[int],
        why: str,
        now_ns: int,
        report: _Kind | None = "power_fault",
        *,
        taken: bool = False,
    ) -> None:
        """Record servos that went off by another cause. They stay off until they are wanted again."""
        lost = servos & self._wanted
        self._lost |= lost
        self._taken |= lost if taken else _NONE
        self._settle(now_ns)
        if report is not None:
            self.news.append(News(report, why, servos))

    # mutants accepted (Forget, Step): else a repeat follows
    def _meddled(self, theirs: frozenset[int], now_ns: int) -> None:
        """Answer another node's mask with ours, without the servos that it cut, even those still waiting for on."""
        begins = self._begins(SET_SUPPLY, now_ns)
        why = "another program switches servos through the power board"
        self._lose(self._target - theirs, why, now_ns, "power_fault" if begins else None, taken=True)
        self._anew(theirs - self._kept, now_ns)
        self._repeat_until_ns = now_ns + REPEAT_FOR_NS
        # Unlike our own masks, answers to another node wait: it may flood the bus.
        self._leave_ns = max(now_ns, self._sent_ns + REST_NS)

    def _begins(self, state: object, now_ns: int) -> bool:
        """Return whether to report a state seen now: it is new, had ended, or there was a reset since."""
        seen_ns, self._seen_ns[state] = self._seen_ns.get(state), now_ns
        return seen_ns is None or now_ns - seen_ns >= LASTS_NS
