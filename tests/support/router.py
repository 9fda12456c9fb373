"""What a gateway dials: a program at that endpoint, in this process."""

import json
from collections.abc import Iterator
from contextlib import contextmanager

import zenoh


@contextmanager
def zenoh_listening(*endpoints: str, **settings: object) -> Iterator[zenoh.Session]:
    """A session that listens there meanwhile, with these sections of a Zenoh file besides."""
    config = zenoh.Config()
    config.insert_json5("mode", '"router"')
    config.insert_json5("listen/endpoints", json.dumps(endpoints))
    config.insert_json5("scouting/multicast/enabled", "false")
    for section, value in settings.items():
        config.insert_json5(section, json.dumps(value))
    with zenoh.open(config) as session:
        yield session
