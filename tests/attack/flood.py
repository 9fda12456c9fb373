"""A program that publishes one payload on one key as fast as it can, until it is killed.

    python -m tests.attack.flood ENDPOINT KEY PAYLOAD

It prints `flooding` once it has begun.
"""

import sys

import zenoh

from gateway.zenoh_config import client_config


def main() -> None:
    """Never ends."""
    endpoint, key, payload = sys.argv[1:]
    with zenoh.open(client_config(endpoint)) as session:
        publisher = session.declare_publisher(key, encoding="application/json")
        publisher.put(payload)
        print("flooding", flush=True)
        while True:
            publisher.put(payload)


if __name__ == "__main__":
    main()
