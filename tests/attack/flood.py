"""A program that publishes one payload on one key as fast as it can, until it is killed.

    python -m tests.attack.flood ENDPOINT KEY PAYLOAD     # or --delete in place of a payload

It prints `flooding` once it has begun.
"""

import sys

import zenoh

from gateway.zenoh_config import client_config

DELETE = "--delete"


def main() -> None:
    """Never ends."""
    endpoint, key, payload = sys.argv[1:]
    with zenoh.open(client_config(endpoint)) as session:
        publisher = session.declare_publisher(key, encoding="application/json")

        def send() -> None:
            if payload == DELETE:
                publisher.delete()
            else:
                publisher.put(payload)

        send()
        print("flooding", flush=True)
        while True:
            send()


if __name__ == "__main__":
    main()
