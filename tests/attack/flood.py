"""A program that publishes one payload on one key as fast as it can, until it is killed.

    python -m tests.attack.flood ENDPOINT KEY PAYLOAD [--ask]

With `--ask` it asks in place of publishing, and waits for no answer. It prints `flooding` once it has begun.
"""

import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import zenoh

from gateway.zenoh_config import client_config
from tests.support.child import Child


@contextmanager
def flooding(endpoint: str, key: str, payload: str, *options: str, prefix: Sequence[str] = ()) -> Iterator[None]:
    """Such a program, which has begun; `prefix` goes before its command."""
    program = [*prefix, sys.executable, "-m", "tests.attack.flood", endpoint, key, payload, *options]
    with Child(program, os.environ) as child:
        child.wait_for_output("flooding")
        yield


def main() -> None:
    """Never ends."""
    endpoint, key, payload, *ask = sys.argv[1:]
    with zenoh.open(client_config(endpoint)) as session:
        publisher = session.declare_publisher(key, encoding="application/json")
        querier = session.declare_querier(key, timeout=0.05, congestion_control=zenoh.CongestionControl.DROP)

        def send() -> None:
            if ask:
                querier.get(zenoh.handlers.RingChannel(1), payload=payload)
            else:
                publisher.put(payload)

        for _ in range(1000 if ask else 1):  # until it is fast
            send()
        print("flooding", flush=True)
        while True:
            send()


if __name__ == "__main__":
    main()
