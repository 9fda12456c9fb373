"""The wires that a robot's controller may speak, by the names of `spi.protocol`."""

import enum
from typing import Final

from gateway.model.framing import Framing
from gateway.wire import Capabilities


class SpiProtocol(enum.StrEnum):
    """HEXAPOD_1_0: the frames of HexapodProtocol v1.0.0. ELKAPOD_2025: full-duplex frames of 80 bytes, and a UART."""

    HEXAPOD_1_0 = "hexapod-1.0"
    ELKAPOD_2025 = "elkapod-2025"

    @property
    def capabilities(self) -> Capabilities:
        """What it can do."""
        known = {SpiProtocol.ELKAPOD_2025: Capabilities(whole_robot=True, measures=True, supply_starts=True)}
        return known.get(self, Capabilities())

    @property
    def framed(self) -> bool:
        """Whether its frames need a framing (`spi.framing`); else a UART starts and stops the servos."""
        return self is SpiProtocol.HEXAPOD_1_0

    @property
    def words(self) -> str:
        """What it is, for people."""
        return "HexapodProtocol v1.0.0: SPI alone" if self.framed else "the Elkapod of 2025: SPI and a UART"

    def version(self, framing: Framing) -> str:
        """What its frames are, as the gateway reports it: the version of HexapodProtocol, or this wire's own name."""
        return framing.protocol if self.framed else self

    def framing(self, framing: Framing) -> str:
        """The framing in use, as the gateway reports it: "none" where frames are transfers as they are."""
        return framing if self.framed else "none"

    @property
    def speed_hz(self) -> int:
        """The clock by default."""
        return 2_500_000 if self.framed else 1_000_000

    @property
    def spi_mode(self) -> int:
        """Clock polarity and phase, as SPI numbers them."""
        return 0 if self.framed else 2


FRAMED: Final = SpiProtocol.HEXAPOD_1_0
"""The wire of SPI alone, whose frames need a framing."""
WITH_UART: Final = SpiProtocol.ELKAPOD_2025
"""The wire whose controller also has a UART."""
