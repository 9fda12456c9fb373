"""The SPI transfers of a frame: one by the protocol document, two for the published controller firmware."""

import enum
from typing import Final

ZERO: Final = b"\0"
PREAMBLE_ZEROS: Final = 16
"""Zeros that synchronise a controller that awaits an announced body: the longest body has 14 bytes.

They complete the body. The controller ignores its type 0, and lengths of 0. Each zero is its own transfer: within one
transfer they arrive faster than the firmware handles lengths of 0, which jams a healthy controller for up to a second.
Zeros that complete half a body would be ids and angles of 0.
"""


class Framing(enum.StrEnum):
    """PLAIN: a frame is one transfer. LENGTH_PREFIXED: its length is sent first, in a transfer of its own."""

    PLAIN = "plain"
    LENGTH_PREFIXED = "length-prefixed"

    @property
    def controller(self) -> str:
        """The controllers that need this framing."""
        if self is Framing.LENGTH_PREFIXED:
            return "the published STM32 firmware"
        return "a controller written to the protocol document"

    @property
    def avoid_cdeg(self) -> tuple[int, int] | None:
        """Wire angles that are never sent: first <= angle < second, in hundredths of a degree; None: all are sent.

        After one lost byte the published firmware takes the whole degrees for an operation, and the operation for a
        servo's id. Ids 0 to 3 and 10 with operations 1 to 3 are a bus fault: it receives nothing until it is reset, and
        its servos stay on. One lost byte makes ids 1 to 3; more lost bytes can still kill it.
        """
        return (1_00, 4_00) if self is Framing.LENGTH_PREFIXED else None

    @property
    def least_gap_us(self) -> float:
        """The shortest pause with which the published firmware loses no frame: 20 µs held in each build, 6 µs failed in
        several."""
        return 20.0 if self is Framing.LENGTH_PREFIXED else 0.0

    @property
    def most_hz(self) -> int:
        """The highest clock: the published firmware lost nothing at 5 and 8 MHz, and 2 % at 10 MHz in one build."""
        return 5_000_000 if self is Framing.LENGTH_PREFIXED else 20_000_000

    def too_fast(self, speed_hz: int, frame_gap_us: float) -> str:
        """Return why a controller with this framing loses frames at this clock and pause, or ""."""
        faults = []
        if speed_hz > self.most_hz:
            faults.append(
                f"speed_hz is {speed_hz}, and {self} allows {self.most_hz} at most: "
                "the published firmware loses bytes of a faster clock"
            )
        if frame_gap_us < self.least_gap_us:
            faults.append(
                f"frame_gap_us is {frame_gap_us:g}, and {self} wants {self.least_gap_us:g} at least: "
                "in shorter pauses the published firmware loses frames, Stops too"
            )
        return "; ".join(faults)


def avoided_by(framing: str) -> tuple[int, int] | None:
    """Return the `avoid_cdeg` of a framing that a gateway reports; None also for an unknown framing."""
    return Framing(framing).avoid_cdeg if framing in Framing.__members__.values() else None
