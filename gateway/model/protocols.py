"""The wires that a robot's controller may speak, by the names of `spi.protocol`."""

import enum

from gateway.model.framing import Framing


class SpiProtocol(enum.StrEnum):
    """HEXAPOD_1_0: the frames of HexapodProtocol v1.0.0. ELKAPOD_2025: full-duplex frames of 80 bytes, and a UART."""

    HEXAPOD_1_0 = "hexapod-1.0"
    ELKAPOD_2025 = "elkapod-2025"

    @property
    def measures(self) -> bool:
        """Whether anything comes back: the controller's state, and what the robot measures."""
        return self is SpiProtocol.ELKAPOD_2025

    @property
    def starts_whole(self) -> bool:
        """Whether only the whole robot can be started and stopped, since the wire knows no servo's start and stop."""
        return self is SpiProtocol.ELKAPOD_2025

    def version(self, framing: Framing) -> str:
        """What its frames are, as the gateway reports it: the version of HexapodProtocol, or this wire's own name."""
        return self if self.measures else framing.protocol

    def framing(self, framing: Framing) -> str:
        """The framing in use, as the gateway reports it: "none" where frames are transfers as they are."""
        return "none" if self.measures else framing

    @property
    def speed_hz(self) -> int:
        """The clock by default."""
        return 1_000_000 if self is SpiProtocol.ELKAPOD_2025 else 2_500_000

    @property
    def spi_mode(self) -> int:
        """Clock polarity and phase, as SPI numbers them."""
        return 2 if self is SpiProtocol.ELKAPOD_2025 else 0
