"""How a frame is cut into SPI transfers: as the document says, or as the published controller firmware wants it."""

import enum
from typing import Final

ZERO: Final = b"\0"
PREAMBLE_ZEROS: Final = 16  # the longest body (14) and some zero lengths, which the controller ignores


class Framing(enum.StrEnum):
    """PLAIN: a frame is one transfer. LENGTH_PREFIXED: its length goes ahead, in a transfer of its own."""

    PLAIN = "plain"
    LENGTH_PREFIXED = "length-prefixed"

    def transfers(self, frame_bytes: bytes) -> tuple[bytes, ...]:
        """The SPI transfers that carry the frame, in order."""
        if self is Framing.LENGTH_PREFIXED:
            return bytes((len(frame_bytes),)), frame_bytes
        return (frame_bytes,)

    @property
    def preamble(self) -> tuple[bytes, ...]:
        """The transfers that synchronise a controller which still awaits an announced body; none for PLAIN.

        They fill that body (its type is then 0, which is ignored), and a length of 0 is ignored too. Each zero has a
        transfer of its own: in one transfer they come faster than the firmware handles lengths of 0, which jams a
        healthy controller for up to a second. In half of a body they would stand for angles of 0°.
        """
        return (ZERO,) * PREAMBLE_ZEROS if self is Framing.LENGTH_PREFIXED else ()
