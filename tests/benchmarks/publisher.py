"""The third process of the benchmark: publishes setpoints for legs, and notes when.

    python -m tests.benchmarks.publisher ENDPOINT --legs 1 2 3 --hz 50 [--log FILE]

The legs are spread evenly over time. What is not a flood carries what the shipped client sends with it: a source, and
the time by the sender's clock.

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
from collections.abc import Sequence
from pathlib import Path

import zenoh

from gateway.zenoh_config import client_config
from schemas.keys import leg_command

ANGLES = 177_00
"""How many numbers fit into one angle: 0.00° to 179.99°, without 1.00° to 3.99°, which one framing does not send."""


def angle_deg(number: int) -> float:
    return (number if number < 1_00 else number + 3_00) / 100


def number_in(whole_deg: int, hundredths: int) -> int:
    return whole_deg * 100 + hundredths - (3_00 if whole_deg else 0)


def payload(number: int) -> str:
    """A leg's command that carries `number`. A start, since that is taken whatever came before."""
    high, low = divmod(number, ANGLES)
    return (
        f'{{"servos":[{{"op":"start","angle_deg":{angle_deg(high)}}},'
        f'{{"op":"start","angle_deg":{angle_deg(low)}}},{{"op":"start","angle_deg":90}}]}}'
    )


def number_of(frame: bytes) -> tuple[int, int] | None:
    """The leg and number that a ONE LEG frame carries; None for any other frame, such as a Stop."""
    if len(frame) != 14 or frame[3] == 2:
        return None
    high, low = number_in(frame[4], frame[5]), number_in(frame[8], frame[9])
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


class Stream:
    """What is sent, in which rhythm."""

    def __init__(self, session: zenoh.Session, legs: Sequence[int], hz: float, *, block: bool) -> None:
        self._as_client = hz > 0
        control = zenoh.CongestionControl.BLOCK if block else zenoh.CongestionControl.DROP
        self._pause_s = 1 / hz / len(legs) if hz else 0.0
        self._publishers = [
            session.declare_publisher(
                leg_command(leg), encoding="application/json", congestion_control=control, express=hz > 0
            )
            for leg in legs
        ]
        self._legs = legs
        self._numbers = itertools.count()

    def run(self, duration_s: float, log: "array.array[int]") -> int:
        """Send for that long. Returns how many messages it were."""
        count = 0
        due_s = time.monotonic()
        end_s = due_s + duration_s
        for leg, publisher in itertools.cycle(zip(self._legs, self._publishers, strict=True)):
            number = next(self._numbers)
            text = payload(number)
            wait_until(due_s)
            now_ns = time.monotonic_ns()
            if now_ns / 1e9 >= end_s:
                return count
            due_s += self._pause_s
            if self._as_client:
                text = f'{text[:-1]},"source":"publisher","sent_ms":{now_ns / 1e6}}}'
            publisher.put(text)
            count += 1
            log.extend((leg, number, now_ns))
        return count


def main() -> None:
    """Publish whenever a line comes."""
    parser = argparse.ArgumentParser(description="Publish setpoints for legs.")
    parser.add_argument("endpoint")
    parser.add_argument("--legs", type=int, nargs="+", required=True)
    parser.add_argument("--hz", type=float, required=True, help="messages a second for each leg; 0: a flood")
    parser.add_argument("--log", type=Path, help="leave it out for runs without end: it grows")
    parser.add_argument("--block", action="store_true", help="wait where the way is congested, and lose nothing")
    options = parser.parse_args()
    with zenoh.open(client_config(options.endpoint)) as session:
        stream = Stream(session, options.legs, options.hz, block=options.block)
        print("ready", flush=True)
        for line in sys.stdin:
            log = array.array("q")
            count = stream.run(float(line), log)
            if options.log:
                with options.log.open("ab") as file:
                    log.tofile(file)
            print("done", count, flush=True)


if __name__ == "__main__":
    main()
