"""Lists of transfers on the emulated device: what the kernel side of a batch sends, and what a driver makes of it."""

import json
import sys
from pathlib import Path

import pytest

from gateway.model.frames import OneServo, Op, ServoOp
from gateway.onboard.computer import SELECT_BY_GPIO
from tests.hil.bed import SpiTestbed
from tests.hil.wire import LATE_S, STOPS, Replay, Wire, settings_for
from tests.support.gateway_process import COMMAND, Gateway

pytestmark = pytest.mark.hil

WRITER = """
import json, sys
from gateway.robot.spi.kernel import KernelDevice
device = KernelDevice("/dev/spidev0.0", 2_500_000, exclusive=False)
for line in sys.stdin:
    count, batch = json.loads(line)
    for _ in range(count):
        device.transfer([(bytes.fromhex(data), pause_us) for data, pause_us in batch])
    print("written", flush=True)
"""
FRAME = [["0e", 50], ["0e010b0200000c0200000d020000", 50]]
ZEROS = [["00", 100]] * 4


def test_check_move_shows_that_a_driver_ignores_cs_change_and_what_to_do(
    tmp_path: Path, spi_testbed: SpiTestbed
) -> None:
    """Whoever looks on sees what a controller does that takes one frame while chip select is held."""
    wire = Wire(spi_testbed)
    spi_testbed.ignore_cs_change()
    with Gateway(tmp_path, settings_for(wire), bed=spi_testbed) as gateway:
        six_stops = b"".join(map(bytes.fromhex, STOPS))
        assert spi_testbed.wait_for_count(1)[0].data == six_stops
        child = spi_testbed.spawn([*COMMAND, "check", "--move", "--connect", gateway.endpoint])
        for answer in ("", "", "yes"):  # servo 61, at 90 degrees
            child.tell(answer)
        child.wait_for_output("All six legs were stopped at once", LATE_S)
        seen = Replay(wire.framing, selects=True).play(spi_testbed.transfers)
        assert 61 in seen.controller.energised
        child.tell("yes")
        child.tell("no")
        assert child.wait(LATE_S) == 1, str(child)
        assert SELECT_BY_GPIO in child.stdout
        left = Replay(wire.framing, selects=True).play(spi_testbed.transfers)
        assert left.controller.energised == frozenset(), "its last Stop is alone in its call"
        assert OneServo(61, ServoOp(Op.STOP)).data in [each.data for each in spi_testbed.transfers if each.delivered]


def test_of_two_writers_none_comes_into_the_other_s_batch(spi_testbed: SpiTestbed) -> None:
    children = [spi_testbed.spawn([sys.executable, "-c", WRITER]) for _ in range(2)]
    for child in children:
        assert child.ask(json.dumps([1, FRAME])) == "written\n", "it has started"
    begun = len(spi_testbed.transfers)
    for child, batch in zip(children, (ZEROS, FRAME), strict=True):
        child.tell(json.dumps([100, batch]))
    transfers = spi_testbed.wait_for_count(begun + 600, timeout_s=30)[begun:]
    written = [each.data.hex() for each in transfers]
    while written:
        expected = [str(data) for data, _ in (ZEROS if written[0] == "00" else FRAME)]
        assert written[: len(expected)] == expected
        written = written[len(expected) :]
    order = [each.opening for each in transfers]
    assert order != sorted(order), "they did take turns"
