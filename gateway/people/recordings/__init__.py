"""MCAP files of what a gateway publishes: written so that a killed writer loses next to nothing, and read again.

`Recording` writes one, `read` yields what can be read of a file, also of one that was cut off or is damaged.
"""

from gateway.people.recordings.drawing import Drawing
from gateway.people.recordings.pieces import ReadLosses
from gateway.people.recordings.reading import RecordedMessage, read
from gateway.people.recordings.writing import REPORTS, Recording

__all__ = [
    "REPORTS", "Drawing", "ReadLosses", "RecordedMessage", "Recording", "read",
]  # fmt: skip
