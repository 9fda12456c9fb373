"""A plug-in (`gateway.wire`) as a device of the bus: frames in, changes of servos out.

So the rules for SPI frames apply to plug-ins: `spi.guard` checks each frame, Stops leave in their own call, and a Stop
that failed is tried alone, first for a leg (`spi.bus`), then for a servo.
"""

import os
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Final

from gateway.errors import ConfigError, DeviceHeldError, SpiError
from gateway.host.descriptors import NO_SPARE, Spare
from gateway.host.directories import SERVICE_RUNTIME, runtime_directory
from gateway.host.settings_table import SpiSettings, WireSettings
from gateway.model.frames import OP_STOP, Framing, decode
from gateway.robot.spi import Batch, SpiDevice
from gateway.robot.spi.bus import Bus
from gateway.robot.spi.outside import Listener
from gateway.wire import ServoWire
from schemas.robot import SERVO_IDS

_FRAMES: Final = SpiSettings(speed_hz=20_000_000, framing=Framing.PLAIN, frame_gap_us=0)
"""Settings with which six legs are one call."""
SINGLY_NS: Final = 50_000_000
"""The longest time for servos one by one: six legs are tried, and after one second systemd ends the gateway."""
_STOP_ALL: Final[tuple[tuple[int, float | None], ...]] = tuple((servo_id, None) for servo_id in SERVO_IDS)


def plugin_bus(wire: WireSettings, *, exclusive: bool = True, spare: Spare = NO_SPARE) -> Bus:
    """Return the bus of a plug-in. `exclusive` is False for `stop-servos`. Raises ConfigError if it does not load.

    `spare` are descriptors kept for it while it is closed.
    """
    try:
        plugin = wire.plugin
    except ValueError as error:
        raise ConfigError(f"wire: {error}") from error
    return Bus(_FRAMES, lambda: spare.open(lambda: PluginDevice(wire.name, plugin, spare, exclusive=exclusive)))


class PluginDevice(SpiDevice):
    def __init__(self, name: str, wire: ServoWire, spare: Spare = NO_SPARE, *, exclusive: bool) -> None:
        """Open the plug-in. Raises SpiError if it raises OSError or another gateway has it, else RuntimeError: a bug of
        the plug-in."""
        self._name = name
        self._wire = wire
        self._spare = NO_SPARE  # while it is being opened, what was released is for it
        self._lock: int | None = None
        self._listener: Listener | None = None
        if exclusive and runtime_directory() is not None:
            self._listen()
        try:
            wire.open()
        except BaseException as error:  # foreign code, whose exit code would become the gateway's
            if not isinstance(error, OSError):
                with suppress(BaseException):
                    wire.apply(_STOP_ALL)
            self.close()
            raise self._fault(error) from error
        self._spare = spare

    def _listen(self) -> None:
        path = lock_path(self._name)
        try:
            self._lock = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o660)
            self._listener = Listener(self._lock)
        except OSError as error:
            if self._lock is not None:  # the plug-in itself is not open yet
                os.close(self._lock)
            held = isinstance(error, BlockingIOError)
            why = f"another gateway has {self._name}; end it first" if held else f"{path}: {error.strerror}"
            raise (DeviceHeldError if held else SpiError)(why) from error

    def transfer(self, batch: Batch) -> None:
        """Apply the batch's frames in one call. Raises SpiError, or RuntimeError for a bug of the plug-in."""
        ops = dict(servo for data, _ in batch for servo in decode(data).servos)
        stops = all(op.op is OP_STOP for op in ops.values())
        changes: tuple[tuple[int, float | None], ...] = tuple(
            (servo_id, None if stops else op.angle_cdeg / 100)
            for servo_id, op in ops.items()
            if stops or op.op is not OP_STOP  # a frame that moves repeats it for servos that are off
        )
        if stops and self._wire.capabilities.whole_robot:
            changes = _STOP_ALL
        try:
            self._wire.apply(changes)
        except BaseException as error:
            if stops and len(changes) < len(SERVO_IDS):
                self._stop_singly(changes)
            raise self._fault(error) from error

    def _fault(self, error: BaseException) -> Exception:
        """Return a fault of the bus for an OSError, else RuntimeError: a bug, which ends the gateway."""
        if isinstance(error, OSError):
            return SpiError(f"{self._name}: {error.strerror or error}")
        return RuntimeError(f"{self._name}: {type(error).__name__}: {error}")

    def _stop_singly(self, changes: Sequence[tuple[int, float | None]]) -> None:
        """Stop servos one by one: if one servo's electronics failed, later ones of the same call may still run."""
        until_ns = time.monotonic_ns() + SINGLY_NS
        for change in changes:
            with suppress(BaseException):
                if time.monotonic_ns() < until_ns:
                    self._wire.apply((change,))

    def stop_servos_at_work(self) -> bool | None:
        return None if self._listener is None else self._listener.poll()

    def close(self) -> None:
        with suppress(BaseException):  # the Stops are already written
            self._wire.close()
        if self._lock is not None:
            os.close(self._lock)
            self._lock = self._listener = None
        self._spare.fill()


def lock_path(name: str) -> Path:
    """Return the file by which a gateway with this plug-in and `stop-servos` notice each other (`spi.outside`)."""
    return (runtime_directory() or SERVICE_RUNTIME) / f"{name.replace('/', '_')}.wire"
