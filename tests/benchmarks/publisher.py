"""Publishes setpoints for legs, spread evenly over time, as the shipped client would send them.

    python -m tests.benchmarks.publisher ENDPOINT --legs 1 2 3 --hz 50
    python -m tests.benchmarks.publisher ENDPOINT --flood KEY PAYLOAD [--ask]

It prints `ready` once it is connected, or listens for gateways that dial it (`--listen`). Then each line on its
standard input is a number of seconds to publish for; it answers `done`. A flood has no end, and as questions
(`--ask`) it waits for no answer.
"""

import argparse
import itertools
import sys
import time

import zenoh

from gateway.host.settings_table import ZenohSettings
from gateway.robot.zenoh_io.session import service_config
from gateway.zenoh.config import client_config
from schemas.keys import leg_command


def payload(number: int) -> str:
    """Return a leg's command with another angle each time. It is a start, which is accepted whatever came before."""
    servo = f'{{"op":"start","angle_deg":{number % 90 + 45}}}'
    return f'{{"servos":[{servo},{servo},{servo}]}}'


def publish(publishers: "itertools.cycle[zenoh.Publisher]", pause_s: float, duration_s: float) -> None:
    """Publish on each in turn, with this pause, for `seconds`."""
    due_s = time.monotonic()
    end_s = due_s + duration_s
    for number in itertools.count():
        time.sleep(max(0.0, due_s - time.monotonic()))
        now_s = time.monotonic()
        if now_s >= end_s:
            return
        due_s += pause_s
        next(publishers).put(f'{payload(number)[:-1]},"source":"publisher","sent_ms":{now_s * 1e3}}}')


def flood(session: zenoh.Session, key: str, payload: str, *, ask: bool) -> None:
    """Send as fast as it can, for ever. Print `flooding` once it is fast."""
    publisher = session.declare_publisher(key, encoding="application/json")
    querier = session.declare_querier(key, timeout=0.05, congestion_control=zenoh.CongestionControl.DROP)
    for count in itertools.count():
        if ask:
            querier.get(zenoh.handlers.RingChannel(1), payload=payload)
        else:
            publisher.put(payload)
        if count == 1000 * ask:
            print("flooding", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description="Publish setpoints for legs.")
    parser.add_argument("endpoint")
    parser.add_argument("--legs", type=int, nargs="+")
    parser.add_argument("--hz", type=float, help="messages a second for each leg")
    parser.add_argument("--flood", nargs=2, metavar=("KEY", "PAYLOAD"))
    parser.add_argument("--ask", action="store_true")
    parser.add_argument("--listen", action="store_true", help="wait for gateways that dial this endpoint")
    options = parser.parse_args()
    settings = ZenohSettings(listen=(options.endpoint,))
    with zenoh.open(service_config(settings) if options.listen else client_config(options.endpoint)) as session:
        if options.flood:
            flood(session, *options.flood, ask=options.ask)
        publishers = itertools.cycle(
            session.declare_publisher(leg_command(leg), encoding="application/json", express=True)
            for leg in options.legs
        )
        print("ready", flush=True)
        for line in sys.stdin:
            publish(publishers, 1 / options.hz / len(options.legs), float(line))
            print("done", flush=True)


if __name__ == "__main__":
    main()
