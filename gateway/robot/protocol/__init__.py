"""The contract of a wire to a controller.

The supervisor decides what servos do (`model.frames`), and a wire sends that: `spi.bus.Bus` in frames of
HexapodProtocol v1.0.0, `spi.cyclic.CyclicBus` in frames of 80 bytes, with a UART. The supervisor only knows whether the
robot starts and stops as a whole (`Rules.starts_whole`).
"""

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

from gateway.errors import ControllerSilentError, SpiError
from gateway.model.frames import Frame
from gateway.robot.protocol.latency import Latency


@dataclass(slots=True)
class Sent:
    """A frame that was written, or is queued for the next cycle."""

    place: int
    """The frame's index in the batch."""
    data: bytes
    """The frame in the bytes of HexapodProtocol v1.0.0, on any wire."""
    ns: int
    """When its last bit had left, computed from the begin of its call and its place on the wire."""
    call_ns: int
    received: bool
    """False if the frame counts as failed, since the zeros before it failed."""


@dataclass(slots=True)
class BatchReport:
    sent: list[Sent] = field(default_factory=list)
    fault: SpiError | None = None
    """The first failure."""
    rejection: str | None = None
    """Why each transfer is a separate call from this batch on, or None."""
    meddled: str | None = None
    """Another program's changes to the device, undone before this batch. Handle them as a fault, since earlier frames
    may have arrived damaged."""


class Wire(Protocol):
    """The way to one robot's controller. Its owner calls it, one call at a time."""

    frames: int
    errors: int
    ended_ns: int
    """When the last call ended (ns, monotonic)."""
    transfer_latency: Latency

    @abstractmethod
    def open(self) -> None:
        """Open the device again. Raises SpiError if that fails."""

    @abstractmethod
    def write(self, frames: Sequence[Frame], *, preamble: bool = False) -> BatchReport:
        """Write frames that all stop, or that all move. `preamble` marks Stops of a repeated run. Return any fault."""

    @abstractmethod
    def close(self) -> None:
        """Release the device. Never raises; closing twice is harmless."""

    def release(self) -> None:
        """Release the part at fault, so that `open` opens it again. Never raises."""
        self.close()

    @abstractmethod
    def stop_servos_at_work(self) -> bool | None:
        """Return whether `stop-servos` uses the same device now; None: not known (closed)."""

    @abstractmethod
    def put_right(self) -> str | None:
        """Undo another program's changes to the device. Return what was found, or None."""

    @property
    def controller_alive(self) -> bool | None:
        """Whether the controller gives signs of life; None: this wire brings none back."""
        return None

    @property
    def answered_ns(self) -> int | None:
        """When the controller last answered; None: not yet, or this wire brings no answer back."""
        return None

    def silent(self, now_ns: int) -> ControllerSilentError | None:  # noqa: ARG002
        """Return why the controller counts as silent from now on, which is a bus fault; None: no change."""
        return None
