"""The power board's interface, opened by python-can. It loads nothing else, since `stop-servos` waits for it."""

import errno
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

from gateway.errors import ConfigError, GatewayError
from gateway.host.settings_table import PowerSettings
from gateway.model.power_board import CanFrame
from gateway.words.own_command import install

if TYPE_CHECKING:
    import can

BITRATE: Final = 1_000_000
"""Fixed by the board's firmware."""
AT_ONCE: Final = 64
PAUSE_S: Final = 0.001
"""Messages of any kind that a call receives at most, and the pause after that number: at a real-time priority, a flood
would occupy the processor."""


class LineError(GatewayError):
    """The interface cannot be opened, or has failed; the text has the reason."""


def open_bus(settings: PowerSettings) -> "can.BusABC":
    """Open the interface. Raises LineError if it does not open now, ConfigError if it never can."""
    import logging  # noqa: PLC0415  (no Stop waits for it)

    try:
        import can  # noqa: PLC0415  (a robot without this board needs none)

        from gateway.robot.power.slcan import Slcan  # noqa: PLC0415
    except ImportError as error:
        raise ConfigError(f"python-can is not installed: {install('power')}") from error
    logging.getLogger("can").setLevel(logging.ERROR)  # python-can warns of each interface that does not open
    channel = settings.channel
    try:
        if settings.interface == "slcan":
            return Slcan(channel, bitrate=BITRATE)
        return can.Bus(
            channel=int(channel) if channel.isdecimal() else channel,
            interface=settings.interface,
            bitrate=BITRATE,
            can_filters=[{"can_id": each, "can_mask": 0x7E0, "extended": False} for each in (0x60, 0x80)],  # 60 to 9F
            ignore_config=True,
        )
    except NotImplementedError as error:
        raise ConfigError(f'power.interface = "{settings.interface}": {error}') from error
    except Exception as error:  # python-can's interfaces have exceptions of their own
        raise LineError(f"{settings.interface} {channel} cannot be opened: {error}") from error


def send(bus: "can.BusABC", frames: Sequence[CanFrame], timeout_s: float) -> Sequence[CanFrame]:
    """Send these frames in their order. Wait for `timeout_s` at most for each, if the interface respects that.

    Return those for which the kernel has no room now. Raises LineError.
    """
    from can import Message  # noqa: PLC0415

    for place, frame in enumerate(frames):
        try:
            bus.send(Message(arbitration_id=frame.id, is_extended_id=False, data=frame.data), timeout=timeout_s)
        except Exception as error:
            if getattr(error, "error_code", None) in (errno.ENOBUFS, errno.EAGAIN):
                return frames[place:]
            raise LineError(str(error)) from error
    return ()


def receive(bus: "can.BusABC", settings: PowerSettings, timeout_s: float) -> list[CanFrame]:
    """Wait for `timeout_s` at most. Return other nodes' frames, without error frames, remote requests, and own echoes.

    Adapters such as gs_usb give echoes. socketcan gives none; there, `is_rx` is false for frames of other programs on
    this computer, such as `stop-servos`. Raises LineError.
    """
    frames: list[CanFrame] = []
    try:
        for _ in range(AT_ONCE):
            message = bus.recv(timeout_s)
            if message is None:
                return frames
            timeout_s = 0
            foreign = message.is_rx or settings.interface == "socketcan"
            if foreign and not (message.is_error_frame or message.is_remote_frame or message.is_extended_id):
                frames.append(CanFrame(message.arbitration_id, bytes(message.data)))
    except Exception as error:
        raise LineError(str(error)) from error
    time.sleep(PAUSE_S)
    return frames
