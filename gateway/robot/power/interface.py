"""The power board's interface, opened by python-can. Loads no more than that: `stop-servos` waits for it."""

from typing import TYPE_CHECKING, Final, Protocol

from gateway.errors import ConfigError, GatewayError

if TYPE_CHECKING:
    import can

FILTERS: Final = [
    {"can_id": 0x60, "can_mask": 0x7E0, "extended": False},
    {"can_id": 0x80, "can_mask": 0x7E0, "extended": False},
]
"""The board's identifiers, 60 to 9F."""


class LineError(GatewayError):
    """The interface cannot be opened; the sentence says why."""


class Interface(Protocol):
    """Of the table [power]: as `PlainPower`, or as the service has it."""

    @property
    def interface(self) -> str: ...
    @property
    def channel(self) -> str: ...
    @property
    def bitrate(self) -> int: ...


def open_bus(settings: Interface) -> "can.BusABC":
    """Open the interface. Raises LineError, with what is missing; ConfigError where it never can be opened."""
    import logging  # noqa: PLC0415  (no Stop waits for it)

    try:
        import can  # noqa: PLC0415  (a robot without this board needs none)

        from gateway.robot.power.slcan import Slcan  # noqa: PLC0415
    except ImportError as error:
        raise ConfigError("python-can is not installed: pip install 'hexapod-gateway[power]'") from error
    logging.getLogger("can").setLevel(logging.ERROR)  # it warns of each interface that could not be opened
    try:
        if settings.interface == "slcan":
            return Slcan(settings.channel, bitrate=settings.bitrate)
        channel = settings.channel
        return can.Bus(
            channel=int(channel) if channel.isdecimal() else channel,
            interface=settings.interface,
            bitrate=settings.bitrate,
            can_filters=FILTERS,
            ignore_config=True,
        )
    except NotImplementedError as error:
        raise ConfigError(f'power.interface = "{settings.interface}": {error}') from error
    except (can.CanError, OSError, ValueError, TypeError) as error:
        raise LineError(f"{settings.interface} {settings.channel} cannot be opened: {error}") from error
