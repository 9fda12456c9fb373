"""The picture in docs/calibration.md, from a real run: `python -m tests.support.calibrate_picture docs/calibrate.svg`.

A gateway on the simulated controller, most of its servos calibrated, and a person who finds servo 32 seven degrees off
and marks how far it may go: the keys are those of the guide, the robot's answers its own.
"""

import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from gateway.people.tools.calibrate.screen import Screen
from gateway.people.tools.calibrate.view import picture
from gateway.robot.core.calibration import calibration_of
from schemas.calibration import ServoChange
from tests.support.gateway_process import Gateway
from tests.support.terminal_picture import svg

COLUMNS, ROWS = 82, 21
SHOWN = "tcp/robot.local:7447"
"""The address on the picture; the run's own is a port of the moment."""
DONE = {
    11: ServoChange(trim_deg=-3.5, min_deg=35, max_deg=145),
    12: ServoChange(trim_deg=1.2, min_deg=20, max_deg=140),
    13: ServoChange(max_deg=150),
    21: ServoChange(trim_deg=2, min_deg=35, max_deg=145),
    22: ServoChange(trim_deg=-5.3, inverted=True, min_deg=20, max_deg=140),
    23: ServoChange(inverted=True, max_deg=150),
    31: ServoChange(trim_deg=0.7, min_deg=35, max_deg=145),
}
KEYS = (*["right"] * 7, "=", "9", "0", "enter", *["left"] * 65, "[", *["right"] * 115, "]", *["left"] * 8, *["up"] * 5)
LATE_S = 20.0


def run(gateway: Gateway) -> str:
    """Press the keys, and draw what stands there then."""
    with gateway.client() as client:
        assert client.calibrate(DONE).accepted
        screen = Screen(client, calibration_of(client.calibration()), client.state())
        session, guide = screen.session, screen.session.guide

        def press(key: str) -> bool:
            before = guide.wire_cdeg
            session.press(key)
            return key not in ("left", "right", "up") or guide.wire_cdeg != before

        for key in ("3", "2", "enter", "enter"):
            press(key)
        until(screen, lambda: screen.held.holding.confirmed)
        for key in KEYS:
            until(screen, lambda key=key: press(key))  # type: ignore[misc]
        with session.lock:
            session.turn()
            drawn = svg(picture(session, SHOWN, ROWS, COLUMNS), "calibrate", COLUMNS, ROWS)
        screen.held.close(LATE_S)
        screen.robot.release()
    return drawn


def until(screen: Screen, holds: Callable[[], bool]) -> None:
    """Try until it holds: a key counts only when the step before is confirmed."""
    end_s = time.monotonic() + LATE_S
    while not holds():
        screen.held.seen()
        if time.monotonic() > end_s:
            sys.exit("this machine was so busy that the keys did not come through; try again")
        time.sleep(0.001)


def main() -> None:
    """Write the picture to the file named."""
    with tempfile.TemporaryDirectory() as folder, Gateway(Path(folder)) as gateway:
        drawn = run(gateway)
    Path(sys.argv[1]).write_text(drawn + "\n")


if __name__ == "__main__":
    main()
