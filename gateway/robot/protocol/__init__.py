"""What the service needs of a wire to a controller, whatever that wire's bytes are.

A step of the supervisor decides what servos do (`model.frames`). A wire sends it: `spi.bus.Bus` in the
frames of HexapodProtocol v1.0.0, `spi.cyclic.CyclicBus` in frames of 80 bytes, with a UART. Neither knows of the
other, and the supervisor knows of neither, but for whether only the whole robot can be started and stopped
(`Rules.starts_whole`).
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
    """What a frame decides is on the wire, or is in what the wire sends next."""

    place: int
    """Which of the frames that were to be written."""
    data: bytes
    """The frame in its own bytes, those of HexapodProtocol v1.0.0, whatever the wire has sent."""
    ns: int
    """When its last bit had left: the begin of its call and its place on the wire. Computed, not measured."""
    call_ns: int
    """How long its call took."""
    received: bool
    """False: it counts as failed, since the zeros before it did."""


@dataclass(slots=True)
class BatchReport:
    """What became of a batch."""

    sent: list[Sent] = field(default_factory=list)
    fault: SpiError | None = None
    """The first failure."""
    rejection: str | None = None
    """Why from this batch on, each transfer is a call of its own."""
    meddled: str | None = None
    """What another program had set on the device. It was put right before anything of this batch was written, and what
    was written before may not have arrived as it was meant: to be taken for a fault."""


class Wire(Protocol):
    """The way to one robot's controller. Its owner calls it, one call at a time."""

    frames: int
    """Written since the start."""
    errors: int
    """Faults since the start."""
    ended_ns: int
    """When the last call ended."""
    transfer_latency: Latency

    @abstractmethod
    def open(self) -> None:
        """Open it anew. Raises SpiError."""

    @abstractmethod
    def write(self, frames: Sequence[Frame], *, preamble: bool = False) -> BatchReport:
        """Write frames that all stop, or that all move. `preamble`: these Stops are a repeated run."""

    @abstractmethod
    def close(self) -> None:
        """Release it. Never raises; closing twice is harmless."""

    def release(self) -> None:
        """Release what is at fault, so that `open` opens it anew. Never raises."""
        self.close()

    @abstractmethod
    def stop_servos_at_work(self) -> bool | None:
        """Whether `stop-servos` stops the servos through the same device now; None: not known (closed)."""

    @abstractmethod
    def put_right(self) -> str | None:
        """Set again what another program has changed on the device, and return what was found; None: nothing."""

    @property
    def controller_alive(self) -> bool | None:
        """Whether the controller gives signs of life; None: this wire brings none back."""
        return None

    @property
    def answered_ns(self) -> int | None:
        """When the controller last answered; None: not yet, or this wire brings no answer back."""
        return None

    def silent(self, now_ns: int) -> ControllerSilentError | None:  # noqa: ARG002
        """Why the controller counts as silent from now on, which is a fault like a lost bus; None: nothing new."""
        return None
