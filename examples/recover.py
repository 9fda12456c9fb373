"""A gait that goes on by itself when what ended it is over: a fault, a lost link, a reset emergency stop.

Somebody's Stop ends the program: that person decides what follows.
"""

import argparse
import math
import time

from gateway.client import DEFAULT_ENDPOINT, Client, DisconnectedError, GatewayError, StoppedError, Stream

LEGS = range(1, 7)
HZ = 50


def gait(stream: Stream, seconds: float) -> None:
    """All legs swing by 10 degrees, once a second."""
    for tick in range(round(seconds * HZ)):
        swing_deg = 10 * math.sin(2 * math.pi * tick / HZ)
        try:
            stream.set(dict.fromkeys(LEGS, (90, 90 + swing_deg, 90)))
        except (StoppedError, DisconnectedError) as error:
            print("ended:", error, flush=True)
            stream.recover(timeout_s=60)
            print("goes on", flush=True)


def main(endpoint: str, seconds: float) -> None:
    with Client(endpoint, source="recovering gait") as robot:
        print("ready:", robot.wait_ready(), flush=True)
        with robot.stream(HZ) as stream:
            gait(stream, seconds)
        print(stream.missed, "ticks missed,", stream.jitter)


if __name__ == "__main__":
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--connect", default=DEFAULT_ENDPOINT, metavar="ENDPOINT")
    arguments.add_argument("--seconds", type=float, default=10.0)
    given = arguments.parse_args()
    begun_s = time.monotonic()
    try:
        main(given.connect, given.seconds)
    except GatewayError as error:
        raise SystemExit(f"after {time.monotonic() - begun_s:.0f} s: {error}") from None
