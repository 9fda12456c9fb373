"""The power board's interface, opened by python-can. It loads nothing else, since `stop-servos` waits for it."""

import errno
from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

from gateway.errors import ConfigError, GatewayError
from gateway.host.settings_table import PowerSettings
from gateway.model.power_board import CanFrame
from gateway.own_command import install

if TYPE_CHECKING:
    import can

FILTERS: Final = [
    {"can_id": 0x60, "can_mask": 0x7E0, "extended": False},
    {"can_id": 0x80, "can_mask": 0x7E0, "extended": False},
]
"""The board's identifiers, 60 to 9F."""

BITRATE: Final = 1_000_000
"""Fixed by the board's firmware."""


class LineError(GatewayError):
    """The interface cannot be opened; the text has the reason."""


def open_bus(settings: PowerSettings) -> "can.BusABC":
    """Open the interface. Raises LineError if it does not open now, ConfigError if it never can."""
    import logging  # noqa: PLC0415  (no Stop waits for it)

    try:
        import can  # noqa: PLC0415  (a robot without this board needs none)

        from gateway.robot.power.slcan import Slcan  # noqa: PLC0415
    except ImportError as error:
        raise ConfigError(f"python-can is not installed: {install('power')}") from error
    logging.getLogger("can").setLevel(logging.ERROR)  # python-can warns of each interface that does not open
    try:
        if settings.interface == "slcan":
            return Slcan(settings.channel, bitrate=BITRATE)
        channel = settings.channel
        return can.Bus(
            channel=int(channel) if channel.isdecimal() else channel,
            interface=settings.interface,
            bitrate=BITRATE,
            can_filters=FILTERS,
            ignore_config=True,
        )
    except NotImplementedError as error:
        raise ConfigError(f'power.interface = "{settings.interface}": {error}') from error
    except (can.CanError, OSError, ValueError, TypeError) as error:
        raise LineError(f"{settings.interface} {settings.channel} cannot be opened: {error}") from error


def send(bus: "can.BusABC", frames: Sequence[CanFrame], timeout_s: float) -> Sequence[CanFrame]:
    """Send these frames in their order. Wait for `timeout_s` at most for each, if the interface respects that.

    Return those for which the kernel has no room now. Raises CanError, or an interface's own exception.
    """
    from can import CanOperationError, Message  # noqa: PLC0415

    for place, frame in enumerate(frames):
        try:
            bus.send(Message(arbitration_id=frame.id, is_extended_id=False, data=frame.data), timeout=timeout_s)
        except CanOperationError as error:
            if error.error_code not in (errno.ENOBUFS, errno.EAGAIN):
                raise
            return frames[place:]
    return ()


def received(message: "can.Message", settings: PowerSettings) -> CanFrame | None:
    """Return another node's frame, or None for an error, a remote request, or the echo of our own frame.

    Adapters such as gs_usb give echoes. socketcan gives none; there, `is_rx` is false for frames of other programs on
    this computer, such as `stop-servos`.
    """
    if message.is_error_frame or message.is_remote_frame or message.is_extended_id:
        return None
    if not message.is_rx and settings.interface != "socketcan":
        return None
    return CanFrame(message.arbitration_id, bytes(message.data))
