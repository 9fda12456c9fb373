"""What a judge of the supervisor remembers of servos and legs; see `oracle.py`."""

from dataclasses import dataclass, fields
from operator import attrgetter
from typing import Any, Self

from gateway.core.events import StoppedOutside
from gateway.protocol.frames import Op

STOP_SERVOS = {
    "stop-servos at work": StoppedOutside(at_work=True),
    "stop-servos ended": StoppedOutside(at_work=False),
}


class Violation(AssertionError):  # noqa: N818  (the model checker's word for it)
    """The supervisor broke a promise."""


def demand(condition: bool, promise: str) -> None:
    """Raise Violation unless the promise was kept."""
    if not condition:
        raise Violation(promise)


@dataclass(frozen=True, slots=True)
class Want:
    """What an accepted command wants of a servo, as long as no frame has said it."""

    op: Op
    angle_cdeg: int
    number: int


@dataclass(slots=True)
class ServoHistory:
    """One servo: the angle last written while it is energised, what is wanted of it, what is owed to it."""

    written_cdeg: int | None = None
    want: Want | None = None
    owed: int = 0
    owed_ns: int = 0
    stopped_ns: int | None = None
    stopped_by: frozenset[str] = frozenset()

    def clone(self) -> Self:
        """A copy."""
        return type(self)(*_SERVO_FIELDS(self))

    @property
    def on(self) -> bool:
        return self.written_cdeg is not None

    @property
    def starts(self) -> bool:
        return self.want is not None and self.want.op is Op.START

    def stop(self, by: str, instant_ns: int) -> None:
        """A Stop that somebody asked for ends what was wanted."""
        self.want = None
        self.stopped_by = (self.stopped_by if self.stopped_ns == instant_ns else frozenset()) | {by}
        self.stopped_ns = instant_ns


@dataclass(slots=True)
class LegHistory:
    """One leg: when an accepted command last started or set a servo, when a frame moved it, what its bucket held."""

    heard_ns: int | None = None
    moved_ns: int | None = None
    bucket_ns: int = 0
    """After the frame; a rate slot is a period."""

    def clone(self) -> Self:
        """A copy."""
        return type(self)(self.heard_ns, self.moved_ns, self.bucket_ns)


_SERVO_FIELDS: "attrgetter[tuple[Any, ...]]" = attrgetter(*(f.name for f in fields(ServoHistory)))
