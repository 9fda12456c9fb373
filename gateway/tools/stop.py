"""`stop-servos`: the last resort, which must work when nothing else does, and at once."""

from gateway.settings import Settings
from gateway.stop import stop_servos as stop
from gateway.tools.terminal import say


def stop_servos(settings: Settings) -> None:
    """Stop all six legs over SPI."""
    stop(settings)
    say(f"Stop written to all six legs, {1 + settings.watchdog.repeats} times each, on {settings.spi.device}")
