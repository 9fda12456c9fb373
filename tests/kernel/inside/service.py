"""A real service on the real spidev: an emergency stop, another program's settings, a device that goes and returns."""

import fcntl
import os
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

from gateway.client import Client
from gateway.model.frames import Framing
from gateway.people.client.payloads import legs_payload
from schemas import keys
from schemas.event import Event
from tests.kernel.inside import wire
from tests.kernel.inside.batches import OURS, SPEED_HZ
from tests.support.gateway_process import READY, Gateway
from tests.support.heard import events
from tests.support.waiting import wait_until

WRITE_MODE: Final = 0x40016B01
WRITE_SPEED: Final = 0x40046B04
DRIVER: Final = Path("/sys/bus/spi/drivers/spidev")


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
def robot(framing: Framing = Framing.LENGTH_PREFIXED, power: Mapping[str, Any] | None = None) -> Iterator[Robot]:
    """`hexapod-gateway run` on the device, ready and at rest; a slow machine alone stops and rejects nothing."""
    settings: dict[str, dict[str, Any]] = {
        "limits": {"max_age_ms": 0},
        "spi": {"device": wire.DEVICE, "framing": str(framing), "speed_hz": SPEED_HZ},
        "watchdog": {"timeout_ms": 10_000},
        "power": {**(power or {})},
    }
    with TemporaryDirectory() as folder, Gateway(Path(folder), settings, options=(), wait=False) as gateway:
        gateway.child.wait_for_output(READY, 180)  # under emulation it takes half a minute to load
        with Client(gateway.endpoint, source="a scene", timeout_s=20) as client:
            client.wait_ready(60)
            yield Robot(gateway, client)


def stops() -> list[wire.Transfer]:
    return [each for each in wire.passed() if each.data in wire.STOPS]


def wait_for_six(within_s: float = 30) -> None:
    wait_until(lambda: {each.data for each in stops()} == set(wire.STOPS), "six Stops", within_s)


def emergency_stop(framing: Framing) -> str:
    """Six legs run, somebody publishes an emergency stop."""
    frames = wire.announced if framing is Framing.LENGTH_PREFIXED else list
    with robot(framing) as ours:
        ours.start()
        wire.forget()
        ours.client.publish(keys.ESTOP, {})
        wait_for_six()
        wait_until(lambda: bool(ours.events("estop_engaged")), "the event")
        first = next(message for message in wire.messages() if wire.STOPS[0] in message.data)
    assert first.data == frames(wire.STOPS), f"the first run is {[data.hex() for data in first.data]}"
    assert {each.setting for each in first.transfers} == {OURS}
    last = first.transfers[-1]
    return f"six Stops in one message, {(last.end_ns - first.transfers[0].begin_ns) / 1e6:.1f} ms from bit to bit"


def another_hand(request: int, value: bytes) -> None:
    """Open the device for a moment as another program, and set something."""
    device = os.open(wire.DEVICE, os.O_RDWR)
    try:
        fcntl.ioctl(device, request, value)
    finally:
        os.close(device)


PAUSE_S: Final = 0.5
"""Nothing is written for so long: before a first Stop after a pause, what the device is set to has to be looked at."""


def meddled(request: int, value: bytes) -> str:
    """Six legs run, another program sets something, somebody publishes an emergency stop at once.

    A mode is what frames cannot carry by themselves, so the gateway puts it right and publishes it.
    """
    with robot() as ours:
        ours.start()
        time.sleep(PAUSE_S)
        wire.forget()
        another_hand(request, value)
        ours.client.publish(keys.ESTOP, {})
        wait_for_six()
        found = {each.setting for each in stops()}
        assert found == {OURS}, f"Stops left with speed, bits and mode {sorted(found - {OURS})}"
        if request == WRITE_SPEED:
            return f"all Stops left with {OURS}"
        another_hand(request, value)
        wait_until(lambda: bool(ours.events("bus_meddled")), "the event bus_meddled", 10)
        detail = ours.events("bus_meddled")[0].detail
    return f"all Stops left with {OURS}; the event: {detail}"


def lost_zeros() -> str:
    """A call is lost, and from then on each zero: frames pass, and Stops must be among them soon."""
    with robot() as ours:
        ours.start()
        wire.forget()
        wire.give(lose_zeros=1, lose_in=1)
        ours.client.publish(keys.ESTOP, {})
        wait_for_six(60)
        begun_ns = wire.lost()[0].ns
        off_ns = max(next(each.end_ns for each in stops() if each.data == stop) for stop in wire.STOPS)
        count = sum(each.ns < off_ns for each in wire.lost())
        wire.heal()
    took_s = (off_ns - begun_ns) / 1e9
    assert took_s <= MOST_S, f"six Stops after {took_s:.1f} s and {count} lost transfers"
    return f"six Stops after {took_s:.2f} s and {count} lost transfers"


MOST_S: Final = 1.0
"""The aim is 0.5 s on a robot; the emulation's own time is in this."""


def unbound() -> str:
    """The device goes while a list is being written, and comes back."""
    all_set = legs_payload("set", dict.fromkeys(wire.SIX, (95, 95, 95)))
    with robot() as ours:
        ours.start()
        wire.give(xfer_sleep_us=20_000)
        wire.forget()
        ours.client.publish(keys.LEGS_COMMAND, all_set)
        wait_until(lambda: bool(wire.records()), "a transfer")
        (DRIVER / "unbind").write_text("spi0.0")
        wire.give(xfer_sleep_us=0)
        assert not Path(wire.DEVICE).exists(), "the device is still there"
        ours.client.publish(keys.LEGS_COMMAND, all_set)
        wait_until(lambda: bool(ours.events("bus_fault")), "the event bus_fault")
        wire.forget()
        (DRIVER / "bind").write_text("spi0.0")
        wait_for_six()
        wait_until(lambda: bool(ours.events("bus_recovered")), "the event bus_recovered")
        sent = [each.data for each in wire.passed()]
        detail = ours.events("bus_fault")[0].detail
        ours.start()
    first = next(place for place, data in enumerate(sent) if data in wire.STOPS)
    assert sent[: first - 1].count(b"\0") >= 16, "no preamble before the first Stop"
    return f"{detail}; behind a preamble six Stops once it was back; legs start again"
