"""How a frame is cut into SPI transfers: as the document says, or as the published controller firmware wants it."""

import enum
from typing import Final

_PREAMBLE_LEN: Final = 16  # the longest body (14) and some zero lengths, which the controller ignores


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
    def preamble(self) -> bytes | None:
        """The one transfer that brings a controller back in step which still awaits an announced body; None for PLAIN.

        Only to be sent where no half of a body can be on the wire: zeros would complete it with angles of 0°.
        """
        return bytes(_PREAMBLE_LEN) if self is Framing.LENGTH_PREFIXED else None
