"""MCAP files of what a gateway publishes: written so that a killed writer loses next to nothing, and read again.

`Recording` writes one, `repair` makes whole what was cut off or is damaged, `read` yields what can be read of a file.
"""

from gateway.people.recordings.cut_off import Repaired, is_cut_off, is_damaged, repair
from gateway.people.recordings.drawing import Drawing
from gateway.people.recordings.pieces import Losses
from gateway.people.recordings.reading import Message, is_ours, read
from gateway.people.recordings.writing import REPORTS, Recording

__all__ = [
    "REPORTS", "Drawing", "Losses", "Message", "Recording", "Repaired", "is_cut_off", "is_damaged", "is_ours", "read",
    "repair",
]  # fmt: skip
