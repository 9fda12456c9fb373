"""What a gateway dials: a program at that endpoint, in this process."""

import json
from collections.abc import Iterator
from contextlib import contextmanager

import zenoh


@contextmanager
def zenoh_listening(endpoint: str) -> Iterator[zenoh.Session]:
    """A session that listens there meanwhile."""
    config = zenoh.Config()
    config.insert_json5("mode", '"router"')
    config.insert_json5("listen/endpoints", json.dumps([endpoint]))
    config.insert_json5("scouting/multicast/enabled", "false")
    with zenoh.open(config) as session:
        yield session
