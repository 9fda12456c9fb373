"""The errors that end a command: each has an exit code, and one sentence with the remedy."""

import time
from collections.abc import Iterable
from typing import ClassVar


class GatewayError(Exception):
    """An error that ends a command with `exit_code`. Its text is one sentence, or one line per fault, for a person."""

    exit_code: ClassVar[int] = 1
    """Exit code of a command that ends with it. @private"""

    @property
    def lasting(self) -> str:
        """The text without times that pass, for a page that shows it for long. @private"""
        return str(self)


class ConfigError(GatewayError):
    """The configuration, a file it names, or an argument is wrong."""

    exit_code = 2


class SpiError(GatewayError):
    """The SPI device cannot be opened or a transfer failed."""

    exit_code = 3


class DeviceHeldError(SpiError):
    """Another gateway holds the device. Raised before this one writes its first frame there."""

    exit_code = 6


class ControllerSilentError(SpiError):
    """The controller gives no signs of life, on a wire that receives some."""


class ControllerRestartedError(ControllerSilentError):
    """The controller may have restarted: its servos may be slack while the gateway counts them as running."""


class BatchRejectedError(SpiError):
    """The kernel rejected a list of transfers, or one of this length. Nothing of it was written."""


class ZenohError(GatewayError):
    """Zenoh cannot be opened, or no gateway answers."""

    exit_code = 4


class UnreachedError(ZenohError):
    """Connecting failed."""


class DisconnectedError(ZenohError):
    """The link to the gateway is lost, or it does not answer."""


class UnansweredError(DisconnectedError):
    """No authorised gateway has answered."""


class RejectedError(GatewayError):
    """The gateway rejected a command: `reason` (docs/interface.md), and `detail`, a sentence."""

    def __init__(self, reason: str, detail: str) -> None:
        """`reason` and `detail`: as in the gateway's answer."""
        super().__init__(f"rejected: {reason}: {detail}")
        self.reason = reason
        self.detail = detail


class OutOfRangeError(RejectedError, ValueError):
    """A leg, servo or angle is out of range; nothing was sent. `reason` is `invalid`."""

    def __init__(self, detail: str) -> None:
        """A sentence."""
        super().__init__("invalid", detail)


class LeaseError(RejectedError):
    """The gateway rejected a request for its lease. `holder`: who drives; None: unknown."""

    def __init__(self, reason: str, detail: str, holder: str | None = None) -> None:
        """As RejectedError."""
        super().__init__(reason, detail)
        self.holder = holder


class LeaseLostError(LeaseError):
    """The program has lost its lease."""


class StoppedError(GatewayError):
    """The `legs` that a program moved were stopped, or the gateway accepts no commands.

    `cause`: `stop` (somebody's Stop), else the kind of the event (docs/interface.md), such as `watchdog_expired`.
    `by`: who sent the Stop or the emergency stop; None: nobody, or a sender without a name.
    """

    def __init__(
        self, detail: str, legs: Iterable[int], by: str | None = None, cause: str = "", at_s: float | None = None
    ) -> None:
        """`detail`: a sentence. `at_s`: monotonic time of the stop, from which the text states how long ago it was."""
        super().__init__(detail)
        self.legs = tuple(sorted(legs))
        self.by = by
        self.cause = cause
        self.at_s = at_s

    def __str__(self) -> str:
        ago = "" if self.at_s is None else f", {max(0.0, time.monotonic() - self.at_s):.1f} s ago"
        return f"{self.lasting}{ago}"

    @property
    def lasting(self) -> str:
        return str(self.args[0])


class AddressTakenError(GatewayError):
    """Another program listens on the address."""

    exit_code = 5


class WalkError(GatewayError, ValueError):
    """A walk that the geometry does not allow (the text has the limit), or an invalid velocity, height or gait."""

    exit_code = 2
