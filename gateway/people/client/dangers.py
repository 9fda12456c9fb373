"""Decides what means danger to people near the robot, for page, terminals and recordings. Pure."""

from typing import Final, Literal

from schemas.telemetry import Ack, AnyKind, GatewayState, Kind, Mode, PowerReport

Tone = Literal["bad", "warn", "plain"]

_BAD: Final = frozenset(
    {
        Kind.WATCHDOG_EXPIRED,
        Kind.OVERFLOW,
        Kind.ESTOP_ENGAGED,
        Kind.BUS_FAULT,
        Kind.BUS_MEDDLED,
        Kind.CONTROLLER_SILENT,
        Kind.CONTROLLER_RESTARTED,
        Kind.FALLEN,
        Kind.STOPPED_OUTSIDE,
        Kind.BUTTON_SILENT,
        Kind.STOPPING,
        Kind.POWER_CUT,
        Kind.POWER_UNCONFIRMED,
        Kind.POWER_FAULT,
        Kind.SERVO_DRAWS,
        Kind.OFF_BUTTON,
    }
)
"""Events of a stop that nobody commanded leg by leg, or of one that may not have worked."""
_WARN: Final = frozenset(
    {Kind.COMMAND_REJECTED, Kind.BATTERY_LOW, Kind.SERVO_SILENT, Kind.ESTOP_KEPT, Kind.ESTOP_NOT_KEPT}
)

UNCONFIRMED: Final = "STOP is not confirmed: switch the power off by hand."
PATIENCE_NS: Final = 300_000_000
"""The board confirms within 27 to 55 ms; by default the gateway reports after 150 ms that it has not. A state that is
published meanwhile is no alarm. Without an event, two states without a confirmation, so far apart, are an alarm."""


def tone_of(kind: AnyKind) -> Tone:
    """Return the tone of an event of this kind; a later gateway's unknown kind is plain."""
    return "bad" if kind in _BAD else "warn" if kind in _WARN else "plain"


class PowerAlarm:
    """The alarm for a Stop that the power board has not confirmed. A robot without a board has none.

    A board that has never answered may be in standby with everything off; its silence is an alarm only in an emergency
    stop. A board that has answered may power servos, so its silence is an alarm at once.
    """

    def __init__(self) -> None:
        self.sentence = ""
        """The alarm for people, or ""."""
        self._since_ns: int | None = None
        """When the first of the unconfirmed states was received."""

    def received_state(self, state: GatewayState, now_ns: int) -> None:
        """Take the newest state, received at `now_ns` (monotonic)."""
        power = state.power
        if power is None or (power.alive and power.confirmed):
            self.sentence, self._since_ns = "", None
        elif power.alive:
            self._since_ns = now_ns if self._since_ns is None else self._since_ns
            if now_ns - self._since_ns >= PATIENCE_NS:
                self.sentence = UNCONFIRMED
        elif power.age_ms is not None or state.mode == Mode.ESTOPPED:
            self.sentence = UNCONFIRMED

    def received_event(self, kind: AnyKind) -> None:
        """Take an event of this kind. Its alarm ends with a state in which the board confirms."""
        if kind == Kind.POWER_UNCONFIRMED:
            self.sentence = UNCONFIRMED

    def answered(self, ack: Ack) -> None:
        """Take the answer to a Stop. If that Stop leaves the power on, the next state ends the alarm."""
        if ack.confirmed is not None:
            self.sentence = "" if ack.confirmed else UNCONFIRMED


def confirmed_off(ack: Ack) -> str:
    """Return the end of a sentence, `, power confirmed off after 34 ms`, or "" without a confirmation."""
    after = "" if ack.confirmed_ms is None else f" after {ack.confirmed_ms:.0f} ms"
    return f", power confirmed off{after}" if ack.confirmed else ""


def power_now(power: PowerReport | None) -> str:
    """Return how the board powers the servos, in a few words, or "" without a board."""
    if power is None:
        return ""
    if not power.alive:
        return "does not answer"
    fed = f"{len(power.supplied)} fed" if power.supplied else ""
    if not power.confirmed:
        return ", ".join(("off not confirmed", *([fed] if fed else [])))
    return fed or "confirmed off"
