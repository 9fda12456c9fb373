"""What the robot does now, in sentences for people. Pure.

Only the gateway's newest state shows what is true now. A driver (a `Ride`) knows only what it wanted, and adds the
posture. An error's sentence states what has ended a drive, in the past tense, so it stays true on a screen.
"""

from collections.abc import Collection
from typing import Final

from gateway.people.walking.motion import DOWN, Posture, WalkState
from gateway.words.text import legs_named
from schemas.gateway_state import GatewayState
from schemas.robot import LEGS
from schemas.words import Mode

NEWS_S: Final = 1.0
"""The oldest state that counts as current: by default the gateway publishes ten a second."""
_MODES: Final[dict[str, str]] = {
    Mode.STARTING: "The gateway starts",
    Mode.BUS_FAULT: "Bus fault: what was written may not have arrived",
    Mode.STOPPING: "The gateway ends, and stops all six legs",
}
_POSTURES: Final = {
    Posture.LYING: "It lies",
    Posture.SITTING: "It sits",
    Posture.STANDING: "It stands",
    Posture.WALKING: "It walks",
    Posture.MOVING: "It moves to another posture",
}


# mutants accepted (Step): without a state there is no age
def robot_now(state: GatewayState | None, age_s: float = 0.0, walk: WalkState | None = None) -> str:
    """Return what the robot does, in one sentence without its full stop.

    `age_s`: how long ago the state was received. `walk`: the state of a walk that has not ended. A leg that is stopped
    in `state` outweighs its posture.
    """
    if state is None:
        return "What it does is not known: the gateway has published no state yet"
    if age_s > NEWS_S:
        return f"What it does is not known: the newest state is {age_s:.0f} s old"
    if state.mode == Mode.ESTOPPED:
        by = "" if state.estop_source is None else f" by {state.estop_source}"
        return f"Emergency stop{by}: nothing runs until a reset"
    if state.mode == Mode.BUS_FAULT and state.controller.alive is False:
        return "The controller is silent: what was written may not have arrived"
    return _MODES.get(state.mode) or _of_legs(state, walk)


def ground_now(walk: WalkState) -> str:
    """Return what a walk by sensors feels of the ground, and how far it has levelled itself; "" for other walks."""
    if walk.terrain != "adapt":
        return ""
    if walk.tilt_deg is None and walk.carrying is None:
        return "No sensors: it walks as on a level floor"
    said = [f"Leans by {walk.tilt_deg:.1f}°, {walk.corrected_deg:.1f}° corrected"] if walk.tilt_deg is not None else []
    if walk.carrying is not None:
        legs = [leg for leg, carries in zip(LEGS, walk.carrying, strict=True) if carries]
        said.append(_legs(legs, "carries", "carry") if legs else "No leg carries")
    if walk.hanging:
        said.append(f"{_legs(walk.hanging, 'hangs', 'hang')} over an edge")
    first, *more = said
    return "; ".join([first, *(each[0].lower() + each[1:] for each in more)])


class Newest:
    """The gateway's newest state, published or as an answer."""

    def __init__(self) -> None:  # mutants accepted (Step): set before it is read
        self._newest: tuple[GatewayState | None, float] = (None, 0.0)
        """The state and when it was received: one object, since reports arrive on another thread."""

    def take(self, state: GatewayState, now_s: float) -> None:  # mutants accepted (Step): an age of 1 s is as good as 0
        """Take a state. Reports and answers may overtake each other: an older state comes less than `NEWS_S` later."""
        newest, _ = self._newest
        late_s = 0.0 if newest is None else newest.uptime_s - state.uptime_s
        if not 0 < late_s < NEWS_S:  # otherwise the gateway was restarted
            self._newest = state, now_s

    def stopped(self, legs: Collection[int]) -> None:
        """Take a report, newer than the state, that these legs were stopped."""
        state, came_s = self._newest
        if state is not None:
            off = {"running": False}
            reports = [
                each.model_copy(update={"servos": tuple(servo.model_copy(update=off) for servo in each.servos)})
                if each.leg in legs
                else each
                for each in state.legs
            ]
            self._newest = state.model_copy(update={"legs": tuple(reports)}), came_s

    @property
    def arrived(self) -> bool:
        """Whether all running servos are where they were commanded. An older gateway reports no targets."""
        state, _ = self._newest
        running = [servo for leg in (state.legs if state else ()) for servo in leg.servos if servo.running]
        return all(servo.target_deg in (None, servo.angle_deg) for servo in running)

    def sentence(self, now_s: float, walk: WalkState | None) -> str:
        """Return `robot_now` for the newest state."""
        state, came_s = self._newest
        return robot_now(state, now_s - came_s, walk)


def _of_legs(state: GatewayState, walk: WalkState | None) -> str:
    some = [leg.leg for leg in state.legs if any(servo.running for servo in leg.servos)]
    whole = frozenset(leg.leg for leg in state.legs if all(servo.running for servo in leg.servos))
    if walk is None or (some and (walk.posture is Posture.LYING or not whole)):
        return _running(some)
    if walk.posture in DOWN or len(whole) == len(LEGS):
        return _POSTURES.get(walk.posture, "All six legs run")
    if not some:
        return "All six legs are stopped, and hold no weight"
    stopped = frozenset(LEGS) - whole
    stand = walk.posture is Posture.HALTED and stopped == frozenset(walk.lost)
    return f"{_legs(stopped, 'is', 'are')} stopped, and the others {'stand still' if stand else 'run'}"


def _running(legs: list[int]) -> str:
    if not legs:
        return "No servo runs"
    return "All six legs run" if len(legs) == len(LEGS) else _legs(legs, "runs", "run")


def _legs(legs: Collection[int], one: str, several: str) -> str:
    return f"{legs_named(legs).capitalize()} {one if len(legs) == 1 else several}"
