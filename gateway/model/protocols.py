"""The built-in wires, by the names of `wire.name`. Both use SPI."""

import enum
from typing import Final

from gateway.wire import Capabilities


class SpiProtocol(enum.StrEnum):
    """HEXAPOD_1_0: the frames of HexapodProtocol v1.0.0. ELKAPOD_2025: full-duplex frames of 80 bytes, and a UART."""

    HEXAPOD_1_0 = "hexapod-1.0"
    ELKAPOD_2025 = "elkapod-2025"

    @property
    def capabilities(self) -> Capabilities:
        """The capabilities of the wire."""
        return Capabilities(whole_robot=self is not FRAMED)

    @property
    def words(self) -> str:
        """A description for people."""
        return "HexapodProtocol v1.0.0: SPI alone" if self is FRAMED else "the Elkapod of 2025: SPI and a UART"

    @property
    def speed_hz(self) -> int:
        """The default clock of SPI."""
        return 2_500_000 if self is FRAMED else 1_000_000

    @property
    def spi_mode(self) -> int:
        """Clock polarity and phase, as SPI numbers them."""
        return 0 if self is FRAMED else 2


FRAMED: Final = SpiProtocol.HEXAPOD_1_0
"""SPI alone, with frames that need a framing (`spi.framing`). With the other, a UART starts and stops all servos."""
BUILT_IN: Final = {str(each): each for each in SpiProtocol}
"""The built-in wires by name."""


def called(wire: str) -> str:
    """Return what sentences call the wire of this name. Older gateways state none, and have SPI."""
    return "the SPI bus" if wire in ("", *BUILT_IN) else f"the wire {wire}"
