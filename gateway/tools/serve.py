"""`run`: the service, and what it prints once it is ready."""

from gateway import service
from gateway.client import DEFAULT_ENDPOINT
from gateway.settings import Settings
from gateway.tools.terminal import say, this_command


def run(settings: Settings, *, simulated: bool) -> None:
    """Run the service and, once it is ready, say where it is and what to try next."""

    def ready() -> None:
        robot = "a simulated controller" if simulated else settings.spi.device
        where = ", ".join(settings.zenoh.listen) or settings.zenoh.config
        say(f"hexapod-gateway is ready: {where} → {robot} ({settings.spi.framing})")
        command = f"{this_command()} send leg 3 start 90 45 120 --hold 5{_connect_option(settings)}"
        say(f"Try, in a second terminal: {command}")

    service.run(settings, simulated=simulated, on_ready=ready)


def _connect_option(settings: Settings) -> str:
    """What a client on this machine must add to reach this service."""
    listen = settings.zenoh.listen
    return f" --connect {listen[0]}" if listen and DEFAULT_ENDPOINT not in listen else ""
