"""`walk --seconds S`: without a person, with progress on one line.

The first request to end it makes the robot finish its step and sit down; the second stops it where it is.
"""

import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final

from gateway.errors import RejectedError, StoppedError
from gateway.people.client.walk import Walk
from gateway.people.commands import reach
from gateway.people.commands.reach import Connection
from gateway.people.terminal import clear_line, hint, on_end_signals, say, show_line
from gateway.people.walking.motion import Posture, Velocity, WalkState

_ENDED_EARLY: Final = 130
"""The exit code of a program that Ctrl-C ended, as shells report it."""
_REDRAW_S: Final = 0.2


class AtOnce(BaseException):  # not KeyboardInterrupt, at which a walk sits down
    """The second request to end."""


class EndRequests:
    """Requests to end it early: Ctrl-C, SIGTERM or the end of its terminal."""

    def __init__(self) -> None:
        self.asked = False
        self._may_cut = True

    def ask(self) -> None:
        """Ask for the end, from a signal handler. The second call raises AtOnce."""
        if self.asked and self._may_cut:
            self.stops()
            raise AtOnce
        self.asked = True

    def stops(self) -> None:
        """Stops are being sent: from now on nothing interrupts them."""
        self._may_cut = False


def walk(
    connect: Connection,
    gait: str,
    geometry: Path | None,
    terrain: str,
    velocity: tuple[float, float, float],
    seconds: float,
    height_m: float | None,
) -> int:
    """Stand up, walk, sit down and stop. Returns the exit code. Raises WalkError, ConfigError, ZenohError."""
    wanted = Velocity.checked(*velocity)
    end = EndRequests()
    with connect() as client:
        try:
            with (
                client.lease(source=reach.me()),
                on_end_signals(end.ask),
                client.walk(gait, geometry, terrain=terrain) as robot,
            ):
                whole = go(robot, wanted, seconds, height_m, end)
        except RejectedError as error:
            return reach.rejected(error)
        except StoppedError as error:
            say(str(error))
            return 1
        except AtOnce as cut:
            failed = getattr(cut, "__notes__", [])  # its Stops were not confirmed
            say("; ".join(failed) or "stopped at once: its servos are slack")
            return _ENDED_EARLY
    return 0 if whole else _ENDED_EARLY


def go(
    robot: Walk,
    velocity: Velocity,
    seconds: float,
    height_m: float | None,
    end: EndRequests,
    clock: Callable[[], float] = time.monotonic,
) -> bool:
    """Walk, then sit. Returns whether it walked for all of `seconds`."""
    remarks: set[str] = set()

    def remark(text: str) -> None:
        if text not in remarks:
            remarks.add(text)
            clear_line()
            hint(text)

    shown_s = clock()
    try:
        show_line("stands up …")
        robot.stand(height_m, wait=False)
        while not end.asked and robot.state.posture is Posture.MOVING:
            robot.go()  # waits for a tick
        begun_s = clock()
        while not end.asked and (elapsed_s := clock() - begun_s) < seconds:
            robot.go(*velocity)
            state = robot.state
            if state.limit:
                remark(f"it walks slower than that: {state.limit}")
            if clock() - shown_s >= _REDRAW_S:
                shown_s = clock()
                show_line(f"walks {elapsed_s:.1f} of {seconds:g} s: {went(state)}")
        whole = not end.asked
        if whole:
            robot.stand()
        else:
            remark("it finishes its step and sits down; once more stops it at once")
        show_line(f"{went(robot.state)}; sits down …")
        robot.sit()
        end.stops()
    finally:
        clear_line()
    early = "" if whole else "ended early: "
    say(f"{early}walked {went(robot.state)}; it sits, and its servos are stopped")
    return whole


def went(state: WalkState) -> str:
    """Return the odometry since it stood up: `0.48 m ahead, 0.00 m to the left, turned by 0°`."""
    x_m, y_m, heading_rad = state.odometry
    return f"{x_m:.2f} m ahead, {y_m:.2f} m to the left, turned by {math.degrees(heading_rad):.0f}°".replace(
        "-0.00", "0.00"
    )
