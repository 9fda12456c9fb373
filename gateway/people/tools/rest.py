"""Whether a robot is at rest: what moves a servo by itself begins only then."""

from typing import Final

from gateway.errors import ConfigError
from gateway.people.terminal import this_command
from schemas.telemetry import GatewayState, Mode

_WAIT: Final = "wait until it is idle"


def why_not_at_rest(state: GatewayState) -> str | None:
    """One sentence with what to do; None: it is."""
    if state.mode == Mode.IDLE:
        return None
    remedies = {
        str(Mode.ACTIVE): f"a servo runs; stop it first ({this_command()} stop)",
        str(Mode.ESTOPPED): f"leave the emergency stop first ({this_command()} reset)",
    }
    return f"the gateway is {state.mode}, and nothing is moved: {remedies.get(str(state.mode), _WAIT)}"


def check_at_rest(state: GatewayState) -> None:
    """Raises ConfigError unless it is."""
    why_not = why_not_at_rest(state)
    if why_not is not None:
        raise ConfigError(why_not)
