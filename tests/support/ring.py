"""A black box's bytes as records."""

import tempfile
import zlib
from pathlib import Path
from typing import Any

from gateway.model import black_box as form
from gateway.people.incidents import ring_reader


def parse(data: bytes) -> ring_reader.Records:
    """Return the records, oldest first. Raises NoRingError."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "ring")
        path.write_bytes(data)
        return ring_reader.read(path)


def put(buffer: Any, offset: int, kind: int, sequence: int, ns: int, rest: bytes) -> None:
    """Write one slot, as `RecordRing.append` does."""
    body = form.pack_head(len(rest) + form.HEAD_BYTES, kind, 0, sequence, ns) + rest
    form.pack_slot_into(buffer, offset, zlib.crc32(body), body)
