"""The emulated SPI device proves itself, with the unmodified spidev in programs of their own."""

import errno
import json
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from tests.hil.bed import DEVICE, PROGRAM, SYSTEM_PYTHON, Opened, Segment, Setting, SpiTestbed, Transfer
from tests.support.child import Child

pytestmark = pytest.mark.hil

PEER = Path(__file__).with_name("spi_peer.py")
FRAME = "0e0b01031b5801012328010000"  # nothing here knows the protocol: any bytes will do
STOP = "0e0c0103000001000001000000"


class Peer:
    """A program that does with its spidev what the test says."""

    def __init__(self, bed: SpiTestbed, *, opened: bool = True, privileged: bool = True) -> None:
        self.child: Child = bed.spawn([sys.executable, str(PEER)], privileged=privileged)
        if opened:
            assert self.call("open_path", DEVICE) == {"ok": None}

    def call(self, *line: object) -> Any:
        return json.loads(self.child.ask(json.dumps(line)))

    def begin(self, *line: object) -> None:
        """A call whose answer comes later, if ever."""
        self.child.tell(json.dumps(line))


def failed(code: int) -> dict[str, object]:
    return {"errno": code, "type": type(OSError(code, "")).__name__}


@pytest.fixture
def peer(spi_testbed: SpiTestbed) -> Peer:
    return Peer(spi_testbed)


def test_every_call_arrives_once_in_order_with_its_settings(spi_testbed: SpiTestbed) -> None:
    begin_ns = time.monotonic_ns()
    peer = Peer(spi_testbed, opened=False)
    assert peer.call("open", 0, 0) == {"ok": None}
    assert peer.call("set", "mode", 0) == {"ok": 0}
    assert peer.call("set", "bits_per_word", 8) == {"ok": 8}
    assert peer.call("set", "lsbfirst", False) == {"ok": False}
    assert peer.call("set", "max_speed_hz", 2_500_000) == {"ok": 2_500_000}
    assert peer.call("writebytes2", FRAME) == {"ok": None}
    assert peer.call("writebytes2", STOP) == {"ok": None}
    assert peer.call("xfer2", "010203") == {"ok": [0, 0, 0]}

    events = spi_testbed.events
    assert [type(event) for event in events] == [Opened, *[Setting] * 3, *[Transfer] * 3]
    assert {event.opening for event in events} == {1}
    # spidev sets nothing that it believes set: no ioctl for 8 bits; lsbfirst is a bit of the mode.
    assert [(setting.kind, setting.value, setting.errno) for setting in spi_testbed.settings] == [
        ("mode", 0, 0),
        ("mode", 0, 0),
        ("speed", 2_500_000, 0),
    ]
    transfers = spi_testbed.transfers
    assert [(transfer.kind, transfer.data.hex(), transfer.errno) for transfer in transfers] == [
        ("write", FRAME, 0),
        ("write", STOP, 0),
        ("message", "010203", 0),
    ]
    assert {(transfer.mode, transfer.bits_per_word, transfer.speed_hz) for transfer in transfers} == {(0, 8, 2_500_000)}
    assert transfers[2].segments == (Segment(b"\x01\x02\x03", 2_500_000, 8, 0, False),)
    times_ns = [begin_ns, *(event.monotonic_ns for event in events), time.monotonic_ns()]
    assert times_ns == sorted(times_ns)


def test_each_way_to_write_and_to_read(spi_testbed: SpiTestbed, peer: Peer) -> None:
    for method in ("writebytes", "writebytes2"):
        assert peer.call(method, "0e01ff") == {"ok": None}
    for method in ("xfer", "xfer2", "xfer3"):
        assert peer.call(method, "0e01ff") == {"ok": [0, 0, 0]}
    assert peer.call("readbytes", 4) == {"ok": [0, 0, 0, 0]}
    *written, read = [(transfer.kind, transfer.data) for transfer in spi_testbed.transfers]
    assert written == [("write", b"\x0e\x01\xff")] * 2 + [("message", b"\x0e\x01\xff")] * 3
    assert read == ("read", bytes(4))


def test_a_message_carries_its_own_speed(spi_testbed: SpiTestbed, peer: Peer) -> None:
    assert peer.call("xfer2", "0e", 1_000_000, 7, 8) == {"ok": [0]}
    assert spi_testbed.transfers[0].segments == (Segment(b"\x0e", 1_000_000, 8, 7, False),)


def test_the_clock_is_never_slower_than_a_raspberry_pi_s(spi_testbed: SpiTestbed, peer: Peer) -> None:
    """What asks for 1 Hz gets 7.6 kHz: a byte takes a millisecond, and not eight seconds."""
    peer.call("set", "max_speed_hz", 1)
    assert 12_000 < peer.call("time", "writebytes2", "00" * 12, 1)["ok"] < 2_000_000, "in microseconds"
    assert spi_testbed.transfers[0].speed_hz == 1


def test_what_a_raspberry_pi_does_not_set(spi_testbed: SpiTestbed, peer: Peer) -> None:
    assert peer.call("set", "lsbfirst", True) == failed(errno.EINVAL)
    assert peer.call("set", "bits_per_word", 16) == failed(errno.EINVAL)
    assert [(setting.kind, setting.value, setting.errno) for setting in spi_testbed.settings] == [
        ("mode", 8, errno.EINVAL),
        ("bits", 16, errno.EINVAL),
    ]


def test_mode_outlives_its_program_and_speed_does_not(spi_testbed: SpiTestbed, peer: Peer) -> None:
    assert peer.call("set", "mode", 3) == {"ok": 3}
    assert peer.call("set", "max_speed_hz", 2_500_000) == {"ok": 2_500_000}
    peer.child.kill()

    second = Peer(spi_testbed)
    assert second.call("get", "mode") == {"ok": 3}
    assert second.call("get", "max_speed_hz") == {"ok": 125_000_000}


@pytest.mark.parametrize(("method", "code"), [("writebytes2", errno.EIO), ("xfer3", errno.ENODEV)])
def test_as_many_transfers_fail_as_told(spi_testbed: SpiTestbed, peer: Peer, method: str, code: int) -> None:
    spi_testbed.fail(code, count=2)
    assert [peer.call(method, "01"), peer.call(method, "02")] == [failed(code), failed(code)]
    assert "ok" in peer.call(method, "03")
    assert [(transfer.data, transfer.errno) for transfer in spi_testbed.transfers] == [
        (b"\x01", code),
        (b"\x02", code),
        (b"\x03", 0),
    ]
    assert spi_testbed.delivered == [b"\x03"]


def test_a_short_write_reaches_the_wire_by_half_and_makes_spidev_raise_systemerror(
    spi_testbed: SpiTestbed, peer: Peer
) -> None:
    spi_testbed.shorten(count=1)
    assert peer.call("writebytes2", "01020304") == {"errno": None, "type": "SystemError"}
    assert peer.call("writebytes2", "05") == {"ok": None}
    assert spi_testbed.delivered == [b"\x01\x02", b"\x05"]


def test_all_transfers_fail_until_healed(spi_testbed: SpiTestbed, peer: Peer) -> None:
    spi_testbed.fail()
    assert [peer.call("writebytes2", "01") for _ in range(20)] == [failed(errno.EIO)] * 20
    spi_testbed.heal()
    assert peer.call("writebytes2", "02") == {"ok": None}


def test_a_transfer_takes_as_long_as_told(spi_testbed: SpiTestbed, peer: Peer) -> None:
    spi_testbed.delay_ms(300)
    before_ns = time.monotonic_ns()
    assert peer.call("writebytes2", "01") == {"ok": None}
    assert time.monotonic_ns() - before_ns >= 300_000_000
    assert spi_testbed.transfers[0].monotonic_ns - before_ns < 200_000_000, "recorded when it arrives, not at its end"
    spi_testbed.delay_ms(0)
    assert peer.call("time", "writebytes2", "01", 10)["ok"] < 100_000


@pytest.mark.parametrize(("code", "answer"), [(0, {"ok": None}), (errno.EIO, failed(errno.EIO))])
def test_a_blocked_transfer_ends_when_released(
    spi_testbed: SpiTestbed, peer: Peer, code: int, answer: dict[str, object]
) -> None:
    spi_testbed.block()
    peer.begin("writebytes2", "01")
    spi_testbed.wait_for_data(b"\x01")
    assert peer.child.stdout.count("\n") == 1, "only the opening has been answered"
    spi_testbed.release(code)
    assert json.loads(peer.child.wait_for_line(1)) == answer
    assert peer.call("writebytes2", "02") == {"ok": None}


def test_a_blocked_program_can_be_killed_and_the_device_goes_on(spi_testbed: SpiTestbed, peer: Peer) -> None:
    spi_testbed.block()
    peer.begin("writebytes2", "01")
    spi_testbed.wait_for_count(1)
    peer.child.kill()
    spi_testbed.release()
    assert Peer(spi_testbed).call("writebytes2", "02") == {"ok": None}
    assert [(transfer.data, transfer.opening) for transfer in spi_testbed.transfers] == [(b"\x01", 1), (b"\x02", 2)]


def test_a_device_that_vanishes_and_comes_back(spi_testbed: SpiTestbed, peer: Peer) -> None:
    spi_testbed.remove_node()
    assert peer.call("writebytes2", "01") == failed(errno.ESHUTDOWN)
    assert peer.call("set", "mode", 1) == failed(errno.ESHUTDOWN)
    assert peer.call("close") == {"ok": None}
    assert peer.call("exists", DEVICE) == {"ok": False}
    # More often than umockdev's table has room for, were its socket still in sight.
    assert [peer.call("open_path", DEVICE) for _ in range(60)] == [failed(errno.ENOENT)] * 60

    spi_testbed.restore_node()
    assert peer.call("exists", DEVICE) == {"ok": True}
    assert peer.call("open_path", DEVICE) == {"ok": None}
    assert peer.call("writebytes2", "02") == {"ok": None}
    assert spi_testbed.delivered == [b"\x02"]
    assert spi_testbed.wait_for_opening(2).opening == 2


def test_a_descriptor_from_before_stays_dead(spi_testbed: SpiTestbed, peer: Peer) -> None:
    spi_testbed.remove_node()
    spi_testbed.restore_node()
    assert peer.call("writebytes2", "01") == failed(errno.ESHUTDOWN)
    assert Peer(spi_testbed).call("writebytes2", "02") == {"ok": None}


@pytest.mark.parametrize(("code", "privileged"), [(errno.ENXIO, True), (errno.EACCES, False)])
def test_opening_fails(spi_testbed: SpiTestbed, peer: Peer, code: int, privileged: bool) -> None:
    late = Peer(spi_testbed, opened=False, privileged=privileged)
    spi_testbed.fail_open(code)
    assert [late.call("open_path", DEVICE) for _ in range(40)] == [failed(code)] * 40
    assert peer.call("writebytes2", "01") == {"ok": None}, "who has it open goes on"
    spi_testbed.restore_node()
    assert late.call("open_path", DEVICE) == {"ok": None}
    assert [event.opening for event in spi_testbed.events if isinstance(event, Opened)] == [1, 2]


def test_a_fault_that_cannot_be_had_is_an_error(spi_testbed: SpiTestbed) -> None:
    with pytest.raises(RuntimeError, match="EACCES or ENXIO"):
        spi_testbed.fail_open(errno.EBUSY)


def test_the_device_outlives_a_killed_program(spi_testbed: SpiTestbed, peer: Peer) -> None:
    assert peer.call("writebytes2", FRAME) == {"ok": None}
    peer.child.kill()
    assert peer.child.returncode == -signal.SIGKILL

    assert Peer(spi_testbed).call("writebytes2", STOP) == {"ok": None}
    assert [(transfer.data.hex(), transfer.opening) for transfer in spi_testbed.transfers] == [(FRAME, 1), (STOP, 2)]


def test_a_lock_holds_between_programs_and_dies_with_its_holder(spi_testbed: SpiTestbed, peer: Peer) -> None:
    second = Peer(spi_testbed)
    assert peer.call("flock") == {"ok": None}
    assert second.call("flock") == failed(errno.EWOULDBLOCK)
    peer.child.kill()
    assert second.call("flock") == {"ok": None}


def test_a_lock_on_a_removed_device_does_not_hold_the_new_one(spi_testbed: SpiTestbed, peer: Peer) -> None:
    assert peer.call("flock") == {"ok": None}
    spi_testbed.remove_node()
    spi_testbed.restore_node()
    assert Peer(spi_testbed).call("flock") == {"ok": None}


def test_two_programs_at_once_lose_nothing(spi_testbed: SpiTestbed, peer: Peer) -> None:
    second = Peer(spi_testbed)
    for each, data in ((peer, "01"), (second, "02")):
        each.begin("time", "writebytes2", data, 300)
    transfers = spi_testbed.wait_for_count(600)
    assert (
        sorted((transfer.opening, transfer.data) for transfer in transfers) == [(1, b"\1")] * 300 + [(2, b"\2")] * 300
    )


def test_a_wait_has_an_end_and_says_what_arrived(spi_testbed: SpiTestbed, peer: Peer) -> None:
    assert peer.call("writebytes2", "0e") == {"ok": None}
    with pytest.raises(TimeoutError, match=r"(?s)waited 0.05 s; arrived: .*data=b'\\x0e'"):
        spi_testbed.wait_for_data(b"\x0f", timeout_s=0.05)


def test_by_hand_the_program_logs_passes_signals_on_and_ends_with_the_command(tmp_path: Path) -> None:
    log = tmp_path / "spi.jsonl"
    with subprocess.Popen(
        [SYSTEM_PYTHON, PROGRAM, "--log", log, "--", sys.executable, "-c", BY_HAND], stdout=subprocess.PIPE, text=True
    ) as testbed:
        assert testbed.stdout is not None
        assert testbed.stdout.readline() == "written\n"
        testbed.send_signal(signal.SIGTERM)
        assert testbed.wait(5.0) == 7
    records = [json.loads(line) for line in log.read_text().splitlines()]
    assert [(record["kind"], record.get("data")) for record in records] == [("open", None), ("write", "0e01")]


BY_HAND = """
import signal, sys, spidev
signal.signal(signal.SIGTERM, lambda *_: sys.exit(7))
spi = spidev.SpiDev()
spi.open(0, 0)
spi.writebytes2(b"\\x0e\\x01")
print("written", flush=True)
while True:
    signal.pause()
"""
