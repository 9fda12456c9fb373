"""The errors that end a command: each knows its exit code and says in one sentence what to do."""

from typing import ClassVar


class GatewayError(Exception):
    """Ends the program with `exit_code`; its text is one sentence (or one line per fault) for a person."""

    exit_code: ClassVar[int] = 1


class ConfigError(GatewayError):
    """The configuration, a file it names, or an argument is wrong."""

    exit_code = 2


class SpiError(GatewayError):
    """The SPI device cannot be opened or a transfer failed."""

    exit_code = 3


class ZenohError(GatewayError):
    """Zenoh cannot be opened, or no gateway answers."""

    exit_code = 4


class UnreachedError(ZenohError):
    """No connection comes about."""


class UnansweredError(ZenohError):
    """Nobody who may answer has answered."""
