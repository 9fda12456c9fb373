"""A program that asks one question on one key as fast as it can, and waits for no answer, until it is killed.

    python -m tests.attack.asking ENDPOINT KEY PAYLOAD

It prints `asking` once it has begun.
"""

import sys
from typing import Final

import zenoh

from gateway.zenoh_config import client_config

UNTIL_IT_IS_FAST: Final = 1000


def main() -> None:
    """Never ends."""
    endpoint, key, payload = sys.argv[1:]
    with zenoh.open(client_config(endpoint)) as session:
        querier = session.declare_querier(key, timeout=0.05, congestion_control=zenoh.CongestionControl.DROP)
        for _ in range(UNTIL_IT_IS_FAST):
            querier.get(zenoh.handlers.RingChannel(1), payload=payload)
        print("asking", flush=True)
        while True:
            querier.get(zenoh.handlers.RingChannel(1), payload=payload)


if __name__ == "__main__":
    main()
