"""A real service in the virtual machine, and a client of it."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from gateway.client import Client
from gateway.model.frames import Framing
from schemas.event import Event
from tests.kernel.inside import wire
from tests.kernel.inside.batches import SPEED_HZ
from tests.support.gateway_process import READY, Gateway
from tests.support.heard import events


class Robot:
    """A running service on the device, a client of it, and what it has published."""

    def __init__(self, gateway: Gateway, client: Client) -> None:
        self.gateway = gateway
        self.client = client
        self._heard = events(client)

    def events(self, kind: str) -> list[Event]:
        return [each for each in self._heard.all if str(each.kind) == kind]

    def start(self) -> None:
        """Start all six legs, at 90 degrees."""
        ack = self.client.start_legs(dict.fromkeys(wire.SIX, (90, 90, 90)), check=False)
        assert ack.accepted, ack.detail


@contextmanager
def _once_ready(gateway: Gateway) -> Iterator[None]:
    """Under emulation it takes half a minute to load."""
    gateway.child.wait_for_output(READY, 180)
    yield


@contextmanager
def robot(framing: Framing = Framing.LENGTH_PREFIXED, power: Mapping[str, Any] | None = None) -> Iterator[Robot]:
    """`hexapod-gateway run` on the device, ready and at rest; a slow machine alone stops and rejects nothing."""
    settings: dict[str, dict[str, Any]] = {
        "limits": {"max_age_ms": 0},
        "spi": {"device": wire.DEVICE, "framing": str(framing), "speed_hz": SPEED_HZ},
        "watchdog": {"timeout_ms": 10_000},
        "power": {**(power or {})},
    }
    with (
        TemporaryDirectory() as folder,
        Gateway(Path(folder), settings, options=(), wait=False) as gateway,
        _once_ready(gateway),
        Client(gateway.endpoint, source="a scene", timeout_s=20) as client,
    ):
        client.wait_ready(60)
        yield Robot(gateway, client)
