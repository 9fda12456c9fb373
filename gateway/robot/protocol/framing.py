"""How a frame becomes SPI transfers: one as in the protocol's document, two for the published controller firmware."""

import enum
from typing import Final

ZERO: Final = b"\0"
PREAMBLE_ZEROS: Final = 16
"""Zeros that synchronise a controller which still awaits an announced body: the longest (14), and some.

They complete that body, whose type of 0 the controller ignores, as it ignores lengths of 0. Each zero is a transfer of
its own: in one transfer they arrive faster than the firmware handles lengths of 0, which jams a healthy controller for
up to a second. Zeros that complete half a body would be ids and angles of 0.
"""


class Framing(enum.StrEnum):
    """PLAIN: a frame is one transfer. LENGTH_PREFIXED: its length is sent first, in a transfer of its own."""

    PLAIN = "plain"
    LENGTH_PREFIXED = "length-prefixed"

    @property
    def avoid_cdeg(self) -> tuple[int, int] | None:
        """Wire angles that are not sent by default, in hundredths of a degree: from the first up to the second, which
        is not one of them.

        After one lost byte the published firmware takes the whole degrees for an operation, and the operation for a
        servo's id. Ids 0 to 3 and 10 with operations 1 to 3 are a bus fault: it receives nothing until it is reset, and
        its servos stay on. One lost byte makes only ids 1 to 3 of these. More lost bytes kill it all the same.
        """
        return (1_00, 4_00) if self is Framing.LENGTH_PREFIXED else None


def avoided_by(framing: str) -> tuple[int, int] | None:
    """What a gateway that reports this framing does not send by default; None, too, for one that is not known here."""
    return Framing(framing).avoid_cdeg if framing in Framing.__members__.values() else None
