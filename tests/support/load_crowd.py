"""A crowd at a gateway: many clients connected, and some traffic of theirs.

    python -m tests.support.load_crowd ENDPOINT clients COUNT    sessions, each listening and commanding a little
    python -m tests.support.load_crowd ENDPOINT flood LEG        one leg's setpoints, as fast as this process can
    python -m tests.support.load_crowd ENDPOINT state HZ         asks for the state that often

It prints `ready` when it is at work, and goes on until it is killed. The last one prints how many answers came, a line
a second.
"""

import argparse
import itertools
import time

import zenoh

from gateway.client import leg_payload
from gateway.zenoh_config import client_config
from schemas.keys import EVENT, STATE, leg_command
from tests.benchmarks.publisher import payload

ROUND_S = 0.2
"""In this time each client of the crowd sends one command that the gateway rejects."""


def clients(endpoint: str, count: int) -> None:
    """Every client listens to state and events (nobody reads: rings), and sends commands that are rejected."""
    sessions = [zenoh.open(client_config(endpoint)) for _ in range(count)]
    listeners = [
        session.declare_subscriber(key, zenoh.handlers.RingChannel(1)) for session in sessions for key in (STATE, EVENT)
    ]
    print("ready", len(listeners), flush=True)
    wrong = str(leg_payload("set", (1, 2, 181))).replace("'", '"')
    for session in itertools.cycle(sessions):
        session.put(leg_command(6), wrong)
        time.sleep(ROUND_S / count)


def flood(endpoint: str, leg: int) -> None:
    """A flood of starts."""
    with zenoh.open(client_config(endpoint)) as session:
        publisher = session.declare_publisher(leg_command(leg), encoding="application/json")
        print("ready", flush=True)
        for number in itertools.count():
            publisher.put(payload(number))


def state(endpoint: str, hz: float) -> None:
    """Questions without waiting for the answer to the one before."""
    answers = itertools.count(1)
    with zenoh.open(client_config(endpoint)) as session:
        print("ready", flush=True)
        told_s = time.monotonic()
        count = 0
        while True:
            for _ in session.get(STATE, timeout=1.0):
                count = next(answers)
            if time.monotonic() >= told_s + 1:
                told_s += 1
                print("answers", count, flush=True)
            time.sleep(1 / hz)


def main() -> None:
    """Until killed."""
    parser = argparse.ArgumentParser(description="Be a crowd.")
    parser.add_argument("endpoint")
    parser.add_argument("what", choices=("clients", "flood", "state"))
    parser.add_argument("number", type=int)
    options = parser.parse_args()
    {"clients": clients, "flood": flood, "state": state}[options.what](options.endpoint, options.number)


if __name__ == "__main__":
    main()
