"""The service on a robot of elkapod-2025, with unmodified spidev and pyserial, commanded through Zenoh.

What is said over SPI and over the UART is one stream in order. Only a start that was asked for may stand in it, each
Stop is a shutdown on the UART, and no frame has an angle that nobody commanded.
"""

import os
import threading
import time
import tty
from collections.abc import Iterator
from contextlib import suppress
from itertools import chain
from pathlib import Path
from typing import Any

import pytest

from gateway.client import Client
from gateway.model.elkapod import SHUTDOWN, START
from schemas.robot import LEGS, SERVO_IDS
from schemas.words import Kind
from tests.hil.bed import SpiTestbed, Transfer
from tests.hil.wire import LATE_S, ended
from tests.support.controllers import Elkapod
from tests.support.fixtures import client_fixture
from tests.support.gateway_process import Gateway
from tests.support.heard import events, servos_on, states
from tests.support.robot import angles_of
from tests.support.waiting import wait_until

pytestmark = pytest.mark.hil

ROUNDS = 4
"""Of each Stop: one, and the repeats."""
POSE = {leg: (80.0 + leg, 100.0 + leg, 120.0 + leg) for leg in LEGS}
ALL = frozenset(SERVO_IDS)
ENOUGH = 10
"""Frames to wait for something that must not come."""
BEAT_S = 0.01
"""How often the controller is asked for what it wants to say over the UART."""
WORDS = {START: "start", SHUTDOWN: "shutdown"}


class ElkapodBed(SpiTestbed):
    """A robot of elkapod-2025 for unmodified programs: `/dev/spidev0.0`, and a UART at `uart`.

    `controller`, played by the test's process, has what its servos do, and switches for faults; those of transfers are
    the device's. As on the robot, the controller prepares each answer before the transfer that reads it: the device
    passes a transfer on while it records it, and the next transfer reads the answer. So no transfer waits for the test.
    """

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self.uart = folder / "ttyAMA1"
        self.controller = Elkapod()
        self._line, theirs = os.openpty()  # theirs stays open here, so that the controller's end outlives each program
        tty.setraw(theirs)
        os.set_blocking(self._line, False)
        self.uart.symlink_to(os.ttyname(theirs))
        self._player = threading.Thread(target=self._play, daemon=True)
        self._player.start()

    def close(self) -> str:
        ended = super().close()
        self._player.join()
        return ended

    def said_since(self, since_ns: int = 0) -> list[str]:
        """Return what came since then (monotonic): "frame", and "start" or "shutdown" on the UART."""
        said = [(at_ns, WORDS[message]) for at_ns, message in self.controller.messages]
        said += [(transfer.monotonic_ns, "frame") for transfer in self.transfers]
        return [word for at_ns, word in sorted(said) if at_ns > since_ns]

    def wait_until_said(self, word: str, since_ns: int, times: int = 1) -> None:
        wait_until(lambda: self.said_since(since_ns).count(word) >= times, word, LATE_S)

    def settings_with(self, **sections: dict[str, Any]) -> dict[str, dict[str, Any]]:
        """Return settings of a gateway on this robot."""
        return {**sections, "wire": {"name": "elkapod-2025"}, "controller": {"uart": str(self.uart)}}

    def _play(self) -> None:
        seen = 0
        while (events := self.follow(seen, BEAT_S)) is not None:
            seen += len(events)
            with suppress(BlockingIOError):
                self.controller.write(os.read(self._line, 4096))
            with suppress(BlockingIOError):  # what no program reads is lost, once the kernel keeps no more
                os.write(self._line, self.controller.read())
            with suppress(OSError):  # the emulation has ended
                for event in events:
                    if isinstance(event, Transfer) and event.delivered:
                        self.answer(self.controller.exchange(event.data))


@pytest.fixture
def robot(tmp_path: Path) -> Iterator[ElkapodBed]:
    with ElkapodBed(tmp_path) as bed:
        yield bed


@pytest.fixture
def gateway(robot: ElkapodBed, tmp_path: Path) -> Iterator[Gateway]:
    with Gateway(tmp_path, robot.settings_with(watchdog={"timeout_ms": 10_000}), bed=robot) as gateway:
        yield gateway


client = client_fixture(None)


def start_all(robot: ElkapodBed, client: Client) -> None:
    """Start the whole robot once its frames are clocked; return once the controller has it."""
    robot.wait_for_count(1, LATE_S)
    begun_ns = time.monotonic_ns()
    ack = client.start_legs(POSE, check=False)
    assert ack.accepted, ack
    robot.wait_until_said("start", begun_ns)
    wait_until(lambda: robot.controller.energised == ALL, within_s=LATE_S)


# ---- start


def test_elkapod_2025_begins_with_shutdowns_and_frames_in_which_nothing_moves(
    robot: ElkapodBed, client: Client
) -> None:
    robot.wait_for_count(ENOUGH, LATE_S)
    first, *_ = frames = robot.transfers
    order = robot.said_since()
    assert order.index("frame") >= 1
    assert set(order[: order.index("frame")]) == {"shutdown"}
    assert order.count("shutdown") >= ROUNDS
    assert "start" not in order
    assert {*chain(*(angles_of(each.data).values() for each in frames))} == {90}, "what nobody commanded"
    assert {(each.mode, each.speed_hz, each.bits_per_word, each.segments) for each in frames} == {(2, 1_000_000, 8, 1)}
    # Never more often than asked for: one that was late is not made up for.
    assert frames[-1].monotonic_ns - first.monotonic_ns >= (len(frames) - 2) * 19_000_000
    wait_until(lambda: bool(client.state().controller.alive), within_s=LATE_S)
    assert client.state().wire.name == "elkapod-2025"
    assert not robot.controller.corruptions


# ---- Stops


def test_stop_servos_needs_no_gateway_and_one_notices_it(robot: ElkapodBed, gateway: Gateway, client: Client) -> None:
    heard = events(client)
    start_all(robot, client)
    for count in range(2):
        since_ns = time.monotonic_ns()
        ended(robot, "stop-servos", gateway.config)
        robot.wait_until_said("shutdown", since_ns, ROUNDS)
        assert "start" not in robot.said_since(since_ns)
        assert robot.controller.energised == frozenset()
        if not count:
            heard.wait(lambda event: event.kind is Kind.STOPPED_OUTSIDE)
            assert not servos_on(client.state())
            start_all(robot, client)
            gateway.child.kill()
            gateway.child.wait(LATE_S)
            assert robot.controller.energised == ALL


# ---- faults


def test_a_transfer_that_hangs_delays_no_stop(robot: ElkapodBed, client: Client) -> None:
    start_all(robot, client)
    seen = states(client)
    robot.block()
    robot.wait_for(lambda transfers: any(each.held for each in transfers), LATE_S)
    seen.wait(lambda _: True, count=len(seen.all) + 3)  # the service goes on with all that it does now and then
    since_ns = time.monotonic_ns()
    assert client.estop().accepted
    robot.wait_until_said("shutdown", since_ns)
    assert "frame" not in robot.said_since(since_ns), "it still hangs"
    assert robot.controller.energised == frozenset()
    robot.release()
    robot.wait_until_said("shutdown", since_ns, ROUNDS)
    robot.wait_for_count(len(robot.transfers) + ENOUGH)
    assert "start" not in robot.said_since(since_ns)
    assert robot.controller.energised == frozenset()
