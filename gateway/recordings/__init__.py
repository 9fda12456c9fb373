"""MCAP files of what a gateway says: written so that a killed writer loses next to nothing, and read again.

`Recording` writes one, `repair` makes whole what was cut off, `read` yields what is in a file, cut off or not.
"""

from gateway.recordings.cut_off import Repaired, is_cut_off, is_ours, repair
from gateway.recordings.drawing import Drawing
from gateway.recordings.reading import Message, read
from gateway.recordings.writing import REPORTS, Recording

__all__ = ["REPORTS", "Drawing", "Message", "Recording", "Repaired", "is_cut_off", "is_ours", "read", "repair"]
