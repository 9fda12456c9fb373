"""The contracts of a wire to a controller, and of an SPI device below it, real or simulated.

The supervisor decides what servos do (`model.frames`), and a wire sends that: `bus.Bus` in frames of HexapodProtocol
v1.0.0, `cyclic.CyclicBus` in frames of 80 bytes, with a UART. The supervisor only knows whether the robot starts and
stops as a whole (`Rules.starts_whole`).
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from typing import NamedTuple

from gateway.errors import ControllerSilentError, SpiError
from gateway.model.elkapod import Measured
from gateway.model.frames import Frame
from gateway.robot.protocol.latency import Latency

Transfer = tuple[bytes, int]
"""The bytes of one chip-select cycle, and the shortest pause after them in µs. In v1.0.0 nothing comes back."""
Owner = AbstractContextManager[None]
"""The lock of the robot's state."""
Batch = Sequence[Transfer]
"""Transfers that leave together. No other transfer, of any program, comes between them or into the last pause."""


class OpenDevice(ABC):  # noqa: B024  (its kinds differ in how they write)
    """An opened SPI device. No other program reaches it, unless a device documents otherwise."""

    def stop_servos_at_work(self) -> bool | None:
        """Return whether `stop-servos` uses the same device now (None: not known). Takes microseconds, never raises."""
        return False

    def put_right(self) -> str | None:
        """Restore settings that another program has changed. Return what was found, or None for no change.

        Takes microseconds, never raises.
        """
        return None

    def close(self) -> None:  # noqa: B027
        """Release the device. Never raises; closing twice is harmless."""


class SpiDevice(OpenDevice):
    """A device that writes batches; nothing comes back."""

    most_transfers: int = 32

    @abstractmethod
    def transfer(self, batch: Batch) -> None:
        """Write the batch and its pauses, in one call.

        Raises SpiError if the device reports a fault: any part of the batch may have been written. Raises
        BatchRejectedError if the device takes no batches: nothing was written.
        """


class DuplexDevice(OpenDevice):
    """A device that makes single transfers, during which as many bytes come back."""

    @abstractmethod
    def exchange(self, data: bytes) -> bytes:
        """Write `data` and return the bytes that came back. Raises SpiError: any part may have been written."""


class Sent(NamedTuple):
    """Frames of one call that were written, or are queued for the next cycle."""

    first: int
    """The first frame's index in the batch."""
    frames: int
    """How many frames."""
    ns: int
    """When the call ended: by then its last bit had left, or a UART's message was with the kernel."""
    call_ns: int
    received: bool
    """False if the frames count as failed, since the zeros before them failed."""

    @property
    def places(self) -> range:
        """The frames' indices in the batch."""
        return range(self.first, self.first + self.frames)


class BatchReport:
    fault: SpiError | None = None
    """The first failure."""
    rejection: str | None = None
    """Why each transfer is a separate call from this batch on, or None."""
    meddled: str | None = None
    """Another program's changes to the device, undone before this batch. Handle them as a fault, since earlier frames
    may have arrived damaged."""

    def __init__(self) -> None:
        self.sent: list[Sent] = []


class Wire(ABC):
    """The way to one robot's controller. Its owner calls it, one call at a time."""

    _device: OpenDevice | None
    """None: closed."""
    announces = False
    """Whether the controller reads announced frames. Only such a controller can be out of sync."""
    preamble_ns = 0
    """How long a preamble takes."""
    ready_servos: Callable[[Mapping[int, int | None]], frozenset[int]] | None = None
    """Returns those of the given servos whose angle is on the wire, if supply starts servos; else None."""
    cycle: Callable[[Owner, Callable[[Measured, int], None], Callable[[SpiError], None]], None] | None = None
    """Exchanges one frame, for a thread of its own, if the wire works in cycles; else None."""

    def __init__(self) -> None:
        self.frames = 0
        self.errors = 0
        self.transfer_latency = Latency()

    @abstractmethod
    def open(self) -> None:
        """Open the device again. Raises SpiError if that fails."""

    @abstractmethod
    def write(self, frames: Sequence[Frame], *, preamble: bool = False) -> BatchReport:
        """Write frames that all stop, or that all move. `preamble` marks Stops of a repeated run. Return any fault.

        A Stop in a frame that moves only repeats that its servo is off: a first Stop is a frame of its own.
        """

    @abstractmethod
    def close(self) -> None:
        """Release the device. Never raises; closing twice is harmless."""

    def write_zeros(self) -> bool:
        """Write a part of a preamble in a pause of the stream. Return whether more parts follow. Raises SpiError.

        Between two parts the caller lets Stops pass, so that a Stop waits for one part at most.
        """
        return False

    @property
    def resync_due(self) -> bool:
        """Whether the stream's next pause has to be used for `write_zeros`."""
        return False

    @property
    def just_resynchronised(self) -> bool:
        """Whether nothing was written since the last whole preamble."""
        return False

    def release(self) -> None:
        """Release the part at fault, so that `open` opens it again. Never raises."""
        self.close()

    def stop_servos_at_work(self) -> bool | None:
        """Return whether `stop-servos` uses the same device now; None: not known (closed)."""
        return None if self._device is None else self._device.stop_servos_at_work()

    def put_right(self) -> str | None:
        """Undo another program's changes to the device. Return what was found, or None."""
        return None if self._device is None else self._device.put_right()

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
