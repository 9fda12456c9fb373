"""`stop-servos`: the last resort. It must work at once, and when nothing else does."""

from gateway.settings import Settings
from gateway.spi.stop_all import stop_servos as stop
from gateway.tools.terminal import say


def stop_servos(settings: Settings) -> None:
    """Stop all six legs over SPI."""
    noticed = stop(settings)
    say(f"Stop written to all six legs, {1 + settings.watchdog.repeats} times each, on {settings.spi.device}")
    if noticed is not None:
        say(_NOTICED if noticed else _NOT_NOTICED)


_NOTICED = "The running gateway counts all servos as stopped; they move again when somebody starts them."
_NOT_NOTICED = "The gateway that holds the device has not noticed: it may hang, and its state may say that servos run."
