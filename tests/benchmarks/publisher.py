"""The third process of the benchmark: publishes setpoints for legs, and notes when.

    python -m tests.benchmarks.publisher ENDPOINT --legs 1 2 3 --hz 50 [--log FILE] [--together] [--block]

It prints `ready` once it is connected. Then each line on its standard input is a number of seconds to publish for; it
answers `done COUNT`. The log is appended to after each: three 64-bit numbers a message (leg, number, monotonic ns).
`--hz 0` is a flood: as fast as it can.

The number of a message travels in the angles of joints 1 and 2, in hundredths of a degree, so that whoever looks at the
frame on the wire knows which message it came from, and when that was published.
"""

import argparse
import array
import itertools
import sys
import time
from pathlib import Path

import zenoh

from gateway.zenoh_setup import client_config
from schemas.keys import leg_command

ANGLES = 180_00
"""How many numbers fit into one angle: 0.00° to 179.99°."""


def payload(number: int) -> str:
    """A leg's command that carries `number`. A start, since that is taken whatever came before."""
    high, low = divmod(number, ANGLES)
    return (
        f'{{"servos":[{{"op":"start","angle_deg":{high / 100}}},'
        f'{{"op":"start","angle_deg":{low / 100}}},{{"op":"start","angle_deg":90}}]}}'
    )


def number_of(frame: bytes) -> tuple[int, int] | None:
    """The leg and number that a ONE LEG frame carries; None for any other frame, such as a Stop."""
    if len(frame) != 14 or frame[3] == 2:
        return None
    high, low = frame[4] * 100 + frame[5], frame[8] * 100 + frame[9]
    return frame[2] // 10, high * ANGLES + low


def read_log(path: Path) -> dict[tuple[int, int], int]:
    """When each message was published: (leg, number) → monotonic ns."""
    entries = array.array("q", path.read_bytes())
    return dict(zip(zip(entries[::3], entries[1::3], strict=True), entries[2::3], strict=True))


def wait_until(when_s: float) -> None:
    """Sleep until then; the time that is noted is the one after it, so a late wake-up is in no figure."""
    left_s = when_s - time.monotonic()
    if left_s > 0:
        time.sleep(left_s)


def main() -> None:
    """Publish whenever a line comes."""
    parser = argparse.ArgumentParser(description="Publish setpoints for legs.")
    parser.add_argument("endpoint")
    parser.add_argument("--legs", type=int, nargs="+", required=True)
    parser.add_argument("--hz", type=float, required=True, help="messages a second for each leg; 0: a flood")
    parser.add_argument("--log", type=Path, help="leave it out for runs without end: it grows")
    parser.add_argument("--together", action="store_true", help="all legs in the same instant, not evenly spread")
    parser.add_argument("--block", action="store_true", help="wait where the way is congested, and lose nothing")
    options = parser.parse_args()
    control = zenoh.CongestionControl.BLOCK if options.block else zenoh.CongestionControl.DROP
    numbers = itertools.count()
    with zenoh.open(client_config(options.endpoint)) as session:
        publishers = [
            (
                leg,
                session.declare_publisher(
                    leg_command(leg),
                    encoding="application/json",
                    congestion_control=control,
                    express=options.hz > 0,
                ),
            )
            for leg in options.legs
        ]
        print("ready", flush=True)
        for line in sys.stdin:
            log = array.array("q")
            count = 0
            spread = 1 if options.together else len(publishers)
            pause_s = 1 / options.hz / spread if options.hz else 0.0
            due_s = time.monotonic()
            end_s = due_s + float(line)
            for leg, publisher in itertools.cycle(publishers):
                number = next(numbers)
                text = payload(number)
                if pause_s:
                    wait_until(due_s)
                now_ns = time.monotonic_ns()
                if now_ns / 1e9 >= end_s:
                    break
                publisher.put(text)
                count += 1
                if options.log:
                    log.extend((leg, number, now_ns))
                if not options.together or leg == options.legs[-1]:
                    due_s += pause_s
            if options.log:
                with options.log.open("ab") as file:
                    log.tofile(file)
            print("done", count, flush=True)


if __name__ == "__main__":
    main()
