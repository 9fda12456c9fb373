"""Move one servo by a few degrees, with consent: for `check --move` and `check --stops`.

People stand next to the robot. Nothing moves unless the robot is at rest, nobody else drives, and a person agrees to
the servo and its angles. After each end, also by an error, a sentence reports whether all is stopped.
"""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from types import MappingProxyType
from typing import Any, Final, NamedTuple

from gateway import geometry
from gateway.errors import ConfigError, GatewayError
from gateway.people.client.blocking import Client
from gateway.people.terminal import ask, hint
from gateway.people.walking.planning import lying_deg
from gateway.people.walking.robot import Robot, ranges
from gateway.words.own_command import command
from gateway.words.text import visible
from schemas import keys
from schemas.gateway_state import GatewayState
from schemas.robot import JOINTS, LEGS, MAX_DEG
from schemas.words import Mode

STEP_DEG: Final = 5.0
"""How far one servo moves: enough to be seen, too little to do harm."""
NOTHING_MOVED: Final = "nothing was moved; --yes agrees"


class ServoMotion(NamedTuple):
    """One servo's motion, from `start_deg` to `end_deg` and back."""

    servo_id: int
    start_deg: float
    """0 to 180. A start moves the servo there at once, from any angle."""
    holding: Mapping[int, float] = MappingProxyType({})
    """The angles of all servos if only the whole robot starts. The others hold their angle."""

    @property
    def end_deg(self) -> float:
        """The other angle, within 0 to 180."""
        return self.start_deg + (STEP_DEG if self.start_deg + STEP_DEG <= MAX_DEG else -STEP_DEG)

    @property
    def leg(self) -> int:
        return self.servo_id // 10

    @property
    def started_ids(self) -> list[int]:
        return sorted(self.holding) or [self.servo_id]

    @property
    def key(self) -> str:
        return keys.LEGS_COMMAND if self.holding else keys.servo_command(self.servo_id)

    def payload(self, op: str, angle_deg: float) -> dict[str, Any]:
        """Return the payload that starts or sets (`op`) the servo, and those that hold."""
        if not self.holding:
            return {"op": op, "angle_deg": angle_deg}
        angles_deg = {**self.holding, self.servo_id: angle_deg}
        held = {leg: [{"op": op, "angle_deg": angles_deg[10 * leg + joint]} for joint in JOINTS] for leg in LEGS}
        return {"legs": {str(leg): {"servos": servos} for leg, servos in held.items()}}

    @property
    def which(self) -> str:
        return f"servo {self.servo_id}"


def lying(client: Client, state: GatewayState) -> dict[int, float]:
    """Return each servo's angle (degrees) when this robot lies. Raises WalkError if it cannot lie."""
    return lying_deg(Robot(geometry.load(), ranges(state.limits, client.calibration())))


def ready(client: Client) -> GatewayState:
    """Return the state of a robot that may be moved. Raises ConfigError if it may not, ZenohError without an answer."""
    state = client.state()
    remedies = {
        str(Mode.ACTIVE): f"a servo runs; stop it first ({command('stop')})",
        str(Mode.ESTOPPED): f"leave the emergency stop first ({command('reset')})",
    }
    if state.mode != Mode.IDLE:
        remedy = remedies.get(str(state.mode), "wait until it is idle")
        raise ConfigError(f"the gateway is {state.mode}, and nothing is moved: {remedy}")
    if (holder := state.lease.holder) is not None:
        wait = f"wait until the lease is released ({command('status --follow')})"
        raise ConfigError(f"{visible(holder)} drives, and nothing is moved: {wait}")
    return state


def consent(motion: ServoMotion, state: GatewayState, *, agreed: bool) -> None:
    """Announce the motion. Raises ConfigError unless a person agrees, now or beforehand (`agreed`)."""
    if motion.holding:
        hint(
            "This robot starts and stops as a whole: all 18 servos will go at once to its lying pose, wherever they "
            "stand, and hold. Lay it flat on the ground, or hang it up."
        )
    others = ", with all others" if motion.holding else ""
    hint(
        f"{motion.which.capitalize()} will go to {motion.start_deg:g}° at once, wherever it stands, move between that "
        f"and {motion.end_deg:g}°, and be stopped{others}. Keep people, hands and cables away, and the switch of its "
        "power at hand."
    )
    if state.watchdog.landing_ms:
        hint(f"If commands stop, the servo goes to its landing angle in {state.watchdog.landing_ms:g} ms.")
    if not agreed and ask("Type yes to move it: ") != "yes":
        raise ConfigError(NOTHING_MOVED)


@contextmanager
def stopped_after(which: str, stop: Callable[[], str]) -> Iterator[None]:
    """Call `stop` at the end of a `with`, and print the sentence that it returns. `which`: `servo 61 is`."""
    try:
        yield
    finally:
        try:
            stopped = stop()
        except GatewayError:
            hint(f"Nobody has confirmed that {which} stopped: if one holds, switch the servos' power off.")
            raise
        hint(stopped)
