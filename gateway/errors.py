"""The errors that end a command: each knows its exit code and says in one sentence what to do."""

from collections.abc import Iterable
from typing import ClassVar


class GatewayError(Exception):
    """Ends the program with `exit_code`; its text is one sentence (or one line per fault) for a person."""

    exit_code: ClassVar[int] = 1
    """Of a command that ends by it. @private"""


class ConfigError(GatewayError):
    """The configuration, a file it names, or an argument is wrong."""

    exit_code = 2


class SpiError(GatewayError):
    """The SPI device cannot be opened or a transfer failed."""

    exit_code = 3


class BatchRejectedError(SpiError):
    """The kernel takes no list of transfers, or none as long as this one. Nothing of it was written."""


class ZenohError(GatewayError):
    """Zenoh cannot be opened, or no gateway answers."""

    exit_code = 4


class UnreachedError(ZenohError):
    """No connection comes about."""


class DisconnectedError(ZenohError):
    """The link to the gateway is lost, or it does not answer."""


class UnansweredError(DisconnectedError):
    """Nobody who may answer has answered."""


class RejectedError(GatewayError):
    """The gateway rejected a command: `reason` is its word for why, `detail` its sentence."""

    def __init__(self, reason: str, detail: str) -> None:
        """See docs/interface.md for the reasons."""
        super().__init__(f"rejected: {reason}: {detail}")
        self.reason = reason
        self.detail = detail


class LeaseError(RejectedError):
    """The gateway rejected what was asked about its lease: `holder` drives, as far as it said."""

    def __init__(self, reason: str, detail: str, holder: str | None = None) -> None:
        """As RejectedError."""
        super().__init__(reason, detail)
        self.holder = holder


class LeaseLostError(LeaseError):
    """The lease that a program held is no longer its own."""


class StoppedError(GatewayError):
    """What a program moved was stopped, by the watchdog, by somebody else or by a fault: `legs` names the legs."""

    def __init__(self, detail: str, legs: Iterable[int]) -> None:
        """Make it of a sentence and the legs' numbers."""
        super().__init__(detail)
        self.legs = tuple(sorted(legs))


class AddressTakenError(GatewayError):
    """Another program listens there."""

    exit_code = 5


class WalkError(GatewayError, ValueError):
    """What a robot of this geometry cannot do on its legs, with the limit; or what is no velocity, height or gait."""

    exit_code = 2
