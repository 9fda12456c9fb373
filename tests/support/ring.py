"""A black box's bytes as records."""

import tempfile
from pathlib import Path

from gateway.people.recorder import ring_reader


def parse(data: bytes) -> tuple[ring_reader.Records, int, int]:
    """The records, oldest first; how many slots are damaged and how many missing. Raises NoRingError."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "ring")
        path.write_bytes(data)
        found = ring_reader.read(path)
    return found.records, found.damaged, found.missing
