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
        return Capabilities() if self.framed else Capabilities(whole_robot=True, measures=True)

    @property
    def framed(self) -> bool:
        """Whether the wire's frames need a framing (`spi.framing`). If not, a UART starts and stops the servos."""
        return self is SpiProtocol.HEXAPOD_1_0

    @property
    def words(self) -> str:
        """A description for people."""
        return "HexapodProtocol v1.0.0: SPI alone" if self.framed else "the Elkapod of 2025: SPI and a UART"

    @property
    def speed_hz(self) -> int:
        """The default clock of SPI."""
        return 2_500_000 if self.framed else 1_000_000

    @property
    def spi_mode(self) -> int:
        """Clock polarity and phase, as SPI numbers them."""
        return 0 if self.framed else 2


FRAMED: Final = SpiProtocol.HEXAPOD_1_0
"""The wire with SPI alone, whose frames need a framing."""
BUILT_IN: Final = {str(each): each for each in SpiProtocol}
"""The built-in wires by name."""
