"""The emulated SPI device, with the unmodified spidev in programs of their own: what no other test here looks at.

Its faults (transfers that fail, a device that goes, openings that are rejected) are seen by the tests that cause them.
"""

import errno
import sys
import time
from pathlib import Path

import pytest

from tests.benchmarks.processes import OnDevice
from tests.hil.bed import Opened, Segment, Setting, SpiTestbed, Transfer
from tests.hil.wire import LATE_S
from tests.support.child import Child

pytestmark = pytest.mark.hil


def begin(bed: SpiTestbed, program: str) -> Child:
    """A program whose `spi` is open."""
    return bed.spawn([sys.executable, "-c", f"import spidev\nspi = spidev.SpiDev()\nspi.open(0, 0)\n{program}"])


def run(bed: SpiTestbed, program: str) -> str:
    """The same, to its end: what it has printed."""
    child = begin(bed, program)
    assert child.wait(LATE_S) == 0, str(child)
    return child.stdout


def test_every_call_arrives_once_in_order_with_its_settings(spi_testbed: SpiTestbed) -> None:
    begin_ns = time.monotonic_ns()
    run(
        spi_testbed,
        "spi.mode, spi.bits_per_word, spi.max_speed_hz = 0, 8, 2_500_000\n"
        "spi.writebytes2([14, 1])\nspi.xfer2([1, 2, 3], 1_000_000, 7)\n",
    )
    events = spi_testbed.events
    assert [type(event) for event in events] == [Opened, *[Setting] * 2, *[Transfer] * 2]
    assert {event.opening for event in events} == {1}
    # spidev sets nothing that it believes set: no ioctl for 8 bits.
    assert [(each.kind, each.value, each.errno) for each in spi_testbed.settings] == [
        ("mode", 0, 0),
        ("speed", 2_500_000, 0),
    ]
    written, message = spi_testbed.transfers
    assert (written.kind, written.data, written.segments) == (
        "write",
        b"\x0e\x01",
        (Segment(b"\x0e\x01", 2_500_000, 8, 0, False),),
    )
    assert (message.kind, message.segments) == ("message", (Segment(b"\1\2\3", 1_000_000, 8, 7, False),))
    times_ns = [begin_ns, *(event.monotonic_ns for event in events), time.monotonic_ns()]
    assert times_ns == sorted(times_ns)


def test_mode_outlives_its_program_and_speed_does_not(spi_testbed: SpiTestbed) -> None:
    run(spi_testbed, "spi.mode, spi.max_speed_hz = 3, 2_500_000")
    assert run(spi_testbed, "print(spi.mode, spi.max_speed_hz)").split() == ["3", "125000000"]


@pytest.mark.parametrize(("setting", "seen"), [("lsbfirst = True", ("mode", 8)), ("bits_per_word = 16", ("bits", 16))])
def test_what_a_raspberry_pi_does_not_set(spi_testbed: SpiTestbed, setting: str, seen: tuple[str, int]) -> None:
    rejected = run(spi_testbed, f"try:\n    spi.{setting}\nexcept OSError as error:\n    print(error.errno)")
    assert int(rejected) == errno.EINVAL
    assert [(each.kind, each.value, each.errno) for each in spi_testbed.settings] == [(*seen, errno.EINVAL)]


def test_a_descriptor_from_before_the_device_went_stays_dead(spi_testbed: SpiTestbed) -> None:
    child = begin(
        spi_testbed, "input()\ntry:\n    spi.writebytes2([1])\nexcept OSError as error:\n    print(error.errno)"
    )
    spi_testbed.wait_for_opening(1)
    spi_testbed.remove_node()
    spi_testbed.restore_node()
    child.tell("")
    assert child.wait(LATE_S) == 0, str(child)
    assert int(child.stdout) == errno.ESHUTDOWN
    run(spi_testbed, "spi.writebytes2([2])")
    assert spi_testbed.delivered == [b"\2"]


def test_a_wait_has_an_end_and_says_what_arrived(spi_testbed: SpiTestbed) -> None:
    run(spi_testbed, "spi.writebytes2([14])")
    with pytest.raises(TimeoutError, match=r"(?s)waited 0.05 s; arrived: .*data=b'\\x0e'"):
        spi_testbed.wait_for_data(b"\x0f", timeout_s=0.05)


def test_a_benchmarks_program_has_a_device_of_its_own(spi_testbed: SpiTestbed, tmp_path: Path) -> None:
    """Beside the tests' own; what it writes is in the file by the time that it has ended."""
    program = "import spidev\nspi = spidev.SpiDev()\nspi.open(0, 0)\nspi.writebytes2([14, 1])\nprint('ready')\ninput()"
    with OnDevice([sys.executable, "-u", "-c", program], tmp_path / "log", ready="ready") as device:
        assert [each.data for each in device.written()] == [b"\x0e\x01"]
    assert not spi_testbed.transfers
