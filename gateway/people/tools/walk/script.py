"""`walk --seconds S`: without a person, with progress on one line."""

import math
import sys
import time
from pathlib import Path
from typing import Final

from gateway.errors import GatewayError, LeaseError, RejectedError, StoppedError
from gateway.people.client.walk import Walk
from gateway.people.terminal import hint, say, visible
from gateway.people.tools import driving, kept_lease
from gateway.people.tools.reach import Connection
from gateway.people.walking import Velocity, WalkState

_LINE_S: Final = 0.2


def walk(
    connect: Connection,
    gait: str,
    geometry: Path | None,
    velocity: tuple[float, float, float],
    seconds: float,
    height_m: float | None,
) -> int:
    """Stand up, walk, sit down and stop. Returns the exit code. Raises WalkError, ConfigError, ZenohError."""
    wanted = Velocity.checked(*velocity)
    with connect() as client:
        try:
            with client.lease(source=kept_lease.me()), client.walk(gait, geometry) as robot:
                _go(robot, wanted, seconds, height_m)
        except LeaseError as error:
            return driving.not_acquired(client, error)
        except (StoppedError, RejectedError) as error:
            say(visible(str(error)))
            return 1
    return 0


def _go(robot: Walk, velocity: Velocity, seconds: float, height_m: float | None) -> None:
    line = _Line()
    try:
        line.show("stands up …")
        robot.stand(height_m)
        begun_s = time.monotonic()
        while (elapsed_s := time.monotonic() - begun_s) < seconds:
            robot.go(*velocity)
            state = robot.state
            if state.limit:
                line.remark(f"it is slower than that: {state.limit}")
            line.show(f"walks {elapsed_s:.1f} of {seconds:g} s: {went(state)}", often=True)
        robot.stand()
        result = went(robot.state)
        line.show(f"{result}; sits down …")
        robot.sit()
        line.end()
        say(f"walked {result}; it sits, and its servos are stopped")
    except GatewayError:
        line.end()
        raise


def went(state: WalkState) -> str:
    """`0.48 m ahead, 0.00 m to the left, turned by 0°`, from where it stood up."""
    x_m, y_m, heading_rad = state.odometry
    return f"{x_m:.2f} m ahead, {y_m:.2f} m to the left, turned by {math.degrees(heading_rad):.0f}°".replace(
        "-0.00", "0.00"
    )


class _Line:
    """One line of a terminal, written again and again; nothing where stderr is none."""

    def __init__(self) -> None:
        self._shows = sys.stderr.isatty()
        self._next_s = 0.0
        self._remarks: set[str] = set()

    def show(self, text: str, *, often: bool = False) -> None:
        """In place of what it shows; where it comes often, five times a second."""
        now_s = time.monotonic()
        if self._shows and (not often or now_s >= self._next_s):
            self._next_s = now_s + _LINE_S
            sys.stderr.write(f"\r\x1b[K{text}")
            sys.stderr.flush()

    def remark(self, text: str) -> None:
        """A line of its own, once."""
        if text not in self._remarks:
            self._remarks.add(text)
            self.end()
            hint(text)

    def end(self) -> None:
        """What comes next is another line."""
        if self._shows:
            sys.stderr.write("\r\x1b[K")
            sys.stderr.flush()
