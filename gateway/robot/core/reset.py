"""Whether a reset may be older than the emergency stop that it is to leave. Pure."""

from gateway.allowance import NS_PER_S
from gateway.robot.core.leg import Rules


def may_be_older(names: int | None, latest: int, latched_ns: int | None, instant_ns: int, rules: Rules) -> str | None:
    """Why a reset may have been sent before the latest emergency stop; None: it was sent after it, or there is none.

    `names` is the number of the emergency stop that it leaves (None: it does not say), `latest` that of the latest one.
    """
    if latched_ns is None:
        return None
    age_ns = instant_ns - latched_ns
    if age_ns == 0:
        return "the emergency stop was engaged in the same instant"
    if names is None:
        if age_ns >= rules.unnumbered_reset_ns:
            return None
        return (
            f"the emergency stop was requested {age_ns / NS_PER_S:.1f} s ago; a reset without its number (estop) "
            f"is accepted after {rules.unnumbered_reset_ns / NS_PER_S:g} s"
        )
    if names == latest:
        return None
    what = "a newer" if names < latest else "no such"
    return f"{what} emergency stop was requested: estop is {names}, and the latest is {latest}"
