"""Another program changes the settings of the device that the gateway has open: mode, speed and bits are shared."""

import json
import sys
from pathlib import Path

import pytest

from schemas.telemetry import Kind, Reason
from tests.hil.bed import SpiTestbed, Transfer
from tests.hil.wire import EACH_FRAMING, LATE_S, START_3, STOPS, Wire, start
from tests.support.heard import events

pytestmark = pytest.mark.hil

OWN = {(0, 8, 2_500_000)}

COLLEAGUE = """
import json, sys
import spidev
for line in sys.stdin:
    settings = json.loads(line)
    device = spidev.SpiDev()
    device.open(0, 0)
    for name, value in settings["set"].items():
        try:
            setattr(device, name, value)
        except OSError:
            pass  # spidev reads a mode back, and the gateway may have put it right by then
    print(json.dumps([device.mode, device.bits_per_word, device.max_speed_hz]), flush=True)
    sys.stdin.readline()
    device.close()
    print("closed", flush=True)
"""


class Colleague:
    """Opens the device in a process of its own, with spidev as it is, and changes what it is told to."""

    def __init__(self, bed: SpiTestbed) -> None:
        self._child = bed.spawn([sys.executable, "-c", COLLEAGUE])

    def opens(self, **settings: int) -> list[int]:
        """Mode, bits and speed as it then reads them."""
        found: list[int] = json.loads(self._child.ask(json.dumps({"set": settings})))
        return found

    def closes(self) -> None:
        assert self._child.ask("").strip() == "closed"


def settings_of(transfers: list[Transfer]) -> set[tuple[int, int, int]]:
    return {(each.mode, each.bits_per_word, each.speed_hz) for each in transfers}


@pytest.mark.parametrize("settings", [{"mode": 3}, {"max_speed_hz": 10_000, "mode": 3}, {"no_cs": True}])
@EACH_FRAMING
def test_another_program_s_mode_is_put_right_published_and_a_fault(
    tmp_path: Path, wire: Wire, settings: dict[str, int]
) -> None:
    with start(tmp_path, wire) as gateway, gateway.client() as client:
        heard = events(client)
        assert client.start_leg(3, 90, 45, 120).accepted
        wire.expect(START_3)
        colleague = Colleague(wire.bed)
        _, bits, speed_hz = colleague.opens(**settings)
        mode = 0x40 if "no_cs" in settings else settings["mode"]
        colleague.closes()
        found = heard.wait(lambda event: event.kind is Kind.BUS_MEDDLED, timeout_s=LATE_S)
        assert found.detail == (
            f"/dev/spidev0.0: another program had set SPI mode 0x{mode:02x} instead of 0x00, "
            f"{speed_hz} Hz and {bits} bits"
        )
        assert heard.wait(lambda event: event.kind is Kind.BUS_FAULT).detail == found.detail
        heard.wait(lambda event: event.kind is Kind.BUS_RECOVERED)
        assert settings_of(wire.expect_opening(*STOPS)) == OWN
        assert client.set_leg(3, 91, 45, 120).reason is Reason.SERVO_STOPPED
        assert client.start_leg(3, 90, 45, 120).accepted
        assert settings_of(wire.expect(START_3)) == OWN
        of_the_bus = [Kind.BUS_MEDDLED, Kind.BUS_FAULT, Kind.BUS_RECOVERED]
        assert [event.kind for event in heard.all if event.kind in of_the_bus] == of_the_bus
