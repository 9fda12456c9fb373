"""The emulated robot of elkapod-2025 for programs that use spidev and pyserial themselves, as its own driver does."""

import json
import sys
import termios
from collections.abc import Iterator
from pathlib import Path

import pytest

from gateway.model.elkapod import SHUTDOWN, START, Heartbeats, frame, measured
from schemas.robot import SERVO_IDS
from tests.hil.bed import SpiTestbed
from tests.hil.elkapod_bed import AT_REST, ElkapodBed

pytestmark = pytest.mark.hil

DRIVER = """
import json, sys, serial, spidev
spi = spidev.SpiDev()
spi.open(0, 0)
spi.mode, spi.max_speed_hz = 2, 1_000_000
uart = serial.Serial(sys.argv[1], 1_152_000, stopbits=serial.STOPBITS_TWO, timeout=10) if sys.argv[1:] else None
for line in sys.stdin:
    request = json.loads(line)
    try:
        if "frame" in request:
            answer = bytes(spi.xfer2(list(bytes.fromhex(request["frame"]))))
        elif "write" in request:
            answer = uart.write(bytes.fromhex(request["write"])).to_bytes()
        else:
            answer = uart.read(request["read"])
        print(answer.hex(), flush=True)
    except OSError as error:
        print(error, flush=True)
"""


class Driver:
    """A program of a few lines that does as it is asked."""

    def __init__(self, bed: SpiTestbed, *uart: str) -> None:
        self._child = bed.spawn([sys.executable, "-c", DRIVER, *uart])

    def ask(self, **request: object) -> str:
        return self._child.ask(json.dumps(request)).rstrip()

    def exchange(self, data: bytes) -> bytes:
        return bytes.fromhex(self.ask(frame=data.hex()))


@pytest.fixture
def robot(tmp_path: Path) -> Iterator[ElkapodBed]:
    with ElkapodBed(tmp_path) as bed:
        yield bed


def test_a_driver_finds_the_robot_that_the_document_describes(robot: ElkapodBed) -> None:
    driver = Driver(robot, str(robot.uart))
    targets = [100_00 + place for place in range(len(SERVO_IDS))]
    assert driver.ask(write=SHUTDOWN.hex()) == "0a"
    robot.wait_for_message(SHUTDOWN, timeout_s=20)
    assert robot.terminal() == (termios.B1152000, True, False)
    driver.exchange(frame([90_00] * len(SERVO_IDS)))
    while driver.exchange(frame(targets))[0] != 0x7E:  # the controller's first answer after power-up is garbage
        pass
    assert measured(driver.exchange(frame(targets))).feet == (0,) * 6
    assert robot.controller.energised == frozenset()
    begun = len(robot.events)
    assert driver.ask(write=START.hex()) == "0a"
    robot.wait_for_message(START, since=begun, timeout_s=20)
    while measured(driver.exchange(frame(targets))).feet == (0,) * 6:
        pass
    assert robot.controller.energised == frozenset(SERVO_IDS)
    beats = Heartbeats()
    assert sum(beats.feed(bytes.fromhex(driver.ask(read=20))) for _ in range(4)) >= 3
    begun = len(robot.events)
    driver.ask(write=SHUTDOWN.hex())
    robot.wait_for_message(SHUTDOWN, since=begun, timeout_s=20)
    frames = [each.what for each in robot.said if not isinstance(each.what, str)]
    assert frames[0] == AT_REST
    order = [each.what if isinstance(each.what, str) else "frame" for each in robot.said]
    assert order[0] == order[-1] == "shutdown"
    assert order.count("start") == 1
    assert not robot.controller.corruptions
