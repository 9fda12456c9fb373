"""The picture of `watch` in the README, from a real run: `python -m tests.support.watch_picture docs/watch.svg`.

A gateway on the simulated controller, with certificates. Bert's program lets leg 2 fall silent. Then Anna's holds the
lease and lets five legs step at 50 Hz, and Bert's gets rejections. And `watch`'s own screen.
"""

import math
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from gateway import certs
from gateway.client import Client, leg_payload
from gateway.people.tools.watch.screen import WatchScreen
from schemas import keys
from tests.support.secured import Secured
from tests.support.terminal_picture import svg

COLUMNS, ROWS = 84, 24
WALKING = (1, 3, 4, 5, 6)
SECONDS = 4.0
SHOWN = "tls/robot.local:7447"
"""The address on the picture; the run's own is a port of the moment."""


def angles(leg: int, time_s: float) -> tuple[float, float, float]:
    """Tripod gait, roughly: the feet of odd and even legs half a step apart."""
    phase = 2 * math.pi * (0.8 * time_s + 0.5 * (leg % 2))
    return 90 + 25 * math.sin(phase), 60 + 20 * max(0, math.cos(phase)), 110 - 15 * math.cos(phase)


def walk(client: Client, legs: Sequence[int], seconds: float) -> None:
    """Step at 50 Hz for a while, every leg started first."""
    begin_s = time.monotonic()
    op = "start"
    while (now_s := time.monotonic() - begin_s) < seconds:
        for leg in legs:
            client.publish(keys.leg_command(leg), leg_payload(op, angles(leg, now_s)))
        op = "set"
        time.sleep(0.02)


def run(secured: Secured) -> str:
    """Let the gateway be busy, and draw what `watch` knows of it then."""
    watch = WatchScreen(partial(secured.client, "anna"), SHOWN)
    watch.begin()
    with secured.client("bert") as bert, secured.client("anna") as anna:
        bert.start_leg(2, 90, 45, 120)  # and then no more: the watchdog stops it
        time.sleep(SECONDS / 4)
        with anna.lease():
            walking = threading.Thread(target=walk, args=(anna, WALKING, SECONDS))
            walking.start()
            time.sleep(SECONDS / 2)
            bert.servo(22, "set", 100)
            anna.servo(21, "set", 100)
            anna.ask(keys.leg_command(3), {"servos": [{"op": "set", "angle_deg": 200}] * 3})
            time.sleep(SECONDS / 4)
            text = watch.picture(COLUMNS, ROWS)
            walked = watch.model.running_legs() == len(WALKING)
            walking.join()
    watch.end()
    if not walked:
        sys.exit("this machine was so busy that the watchdog stopped the gait; try again")
    return svg(text, "watch", COLUMNS, ROWS)


def main() -> None:
    """Write the picture to the file named."""
    with tempfile.TemporaryDirectory() as folder, Secured(Path(folder)) as secured:
        certs.folder.issue(secured.folder, "bert", "operator")
        drawn = run(secured)
    Path(sys.argv[1]).write_text(drawn + "\n")


if __name__ == "__main__":
    main()
