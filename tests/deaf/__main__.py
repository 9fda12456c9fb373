"""python -m tests.deaf [--every N]: bytes of a minute lost once, or doubled, each gap stretched; minutes each."""

import argparse
import logging
import sys
import time

from tests.deaf.faults import (
    BoundedController,
    lose_before_stop,
    lose_bytes,
    lose_in_stops,
    lose_transfers,
    recorded,
    stretch_gaps,
)

PHASES_NS = (0, 437_000)
"""How far a tick of the controller's clock has gone when the scene begins."""

RUNS = (2, 3, 5, 14, 30, 100)


def main() -> int:
    """Print the figures; 1 where one lost byte or a stall cost a Stop with its first repeat, or the controller, or
    where bytes lost inside Stops left a servo on with a controller that is alive.

    A doubled byte and more than one lost byte may cost both (docs/protocol.md).
    """
    parser = argparse.ArgumentParser(description="Lost bytes and stalls, on the simulated controller.")
    parser.add_argument("--every", type=int, default=1, help="one fault in so many (default: all)")
    parser.add_argument("--only", choices=("bytes", "doubled", "runs", "gaps", "stops"))
    options = parser.parse_args()
    logging.disable(logging.CRITICAL)  # what a stalled gateway says is not what is looked for
    begun_s, bad = time.monotonic(), False
    log = recorded()
    print(f"{len(log)} transfers, {sum(len(each.data) for each in log)} bytes in a minute")
    for phase_ns in PHASES_NS:
        if options.only in (None, "bytes"):
            lost = lose_bytes(log, every=options.every, tick_phase_ns=phase_ns)
            bad |= bool(lost.stops_after_repeat or lost.dead)
            print(f"bytes lost, ticks at {phase_ns} ns: {lost.text}", flush=True)
        if options.only in (None, "doubled"):
            doubled = lose_bytes(log, every=options.every, tick_phase_ns=phase_ns, doubled=True)
            print(f"bytes doubled, ticks at {phase_ns} ns: {doubled.text}", flush=True)
        if options.only in (None, "gaps"):
            for stall_ms, stalled in stretch_gaps(every=options.every, tick_phase_ns=phase_ns).items():
                bad |= bool(stalled.stops_after_repeat or stalled.left_on)
                print(f"stalls of {stall_ms:g} ms before a call, ticks at {phase_ns} ns: {stalled.text}", flush=True)
    if options.only in (None, "runs"):
        for run in RUNS:
            print(f"{run} bytes lost in a row: {lose_bytes(log, every=options.every, run=run).text}", flush=True)
            bounded = lose_bytes(log, every=options.every, run=run, controller=BoundedController)
            print(f"the same, lengths of 6 and 14 only: {bounded.text}", flush=True)
        for kind, tally in lose_transfers(log, every=options.every).items():
            print(f"{kind} lost: {tally.text}", flush=True)
        for run in (1, *RUNS):
            text = lose_before_stop(run, every=options.every).text
            print(f"{run} lost in the 0.3 s before an emergency stop: {text}", flush=True)
    if options.only in (None, "stops"):
        for run in range(1, 101):
            for where, tally in zip(
                ("and repeats", "behind them"), lose_in_stops(run, every=options.every), strict=True
            ):
                bad |= bool(tally.left_on_alive)
                print(f"{run} lost in Stops {where}: {tally.text}", flush=True)
    print(f"{time.monotonic() - begun_s:.0f} s")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
