"""A real service with its power board on socketcan: two interfaces of the kernel that a cable joins (vxcan)."""

import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from typing import Final

import can

from gateway.model.power_board import ALL, CanFrame, set_supply
from gateway.simulation.board import SimulatedBoard
from tests.kernel.inside.service import Robot, robot
from tests.support.child import Child
from tests.support.heard import servos_on
from tests.support.waiting import wait_until

OURS: Final = "can0"
THEIRS: Final = "board0"
WITHIN_S: Final = 60.0
"""Of anything; a second of a real machine is many here."""


class CanBoard:
    """The simulated board, on a thread of its own, behind the other interface."""

    def __init__(self) -> None:
        self._bus = can.Bus(channel=THEIRS, interface="socketcan", ignore_config=True)
        self._board = SimulatedBoard(time.monotonic_ns())
        self._ends = threading.Event()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    @property
    def fed(self) -> int:
        return self._board.fed

    def close(self) -> None:
        self._ends.set()
        self._thread.join()
        self._bus.shutdown()

    def _serve(self) -> None:
        while not self._ends.is_set():
            try:
                self._step()
            except (can.CanError, OSError):  # the cable is out
                time.sleep(0.01)

    def _step(self) -> None:
        message = self._bus.recv(0.002)
        now_ns = time.monotonic_ns()
        frames = self._board.advance(now_ns)
        if message is not None and not message.is_error_frame:
            frames += self._board.take(CanFrame(message.arbitration_id, bytes(message.data)), now_ns)
        for each in frames:
            self._bus.send(can.Message(arbitration_id=each.id, is_extended_id=False, data=each.data))


def link(*arguments: str) -> None:
    subprocess.run(["ip", "link", *arguments], check=True)


@contextmanager
def robot_with_board() -> Iterator[tuple[Robot, CanBoard]]:
    """Yield a robot whose board answers. A slow machine alone is no silence of the board: it is waited for."""
    link("add", OURS, "type", "vxcan", "peer", "name", THEIRS)
    for name in (OURS, THEIRS):
        link("set", name, "up")
    power = {"interface": "socketcan", "channel": OURS, "confirm_ms": 2000}
    try:
        with closing(CanBoard()) as theirs, robot(power=power) as ours:
            until_alive(ours)
            yield ours, theirs
    finally:
        link("delete", OURS)


def until_alive(ours: Robot) -> None:
    def alive() -> bool:
        power = ours.client.state().power
        return power is not None and power.alive

    wait_until(alive, "the board answers", WITHIN_S)


def started(ours: Robot, theirs: CanBoard) -> None:
    ours.start()

    def fed() -> bool:
        power = ours.client.state().power
        return theirs.fed == ALL and power is not None and len(power.supplied) == ALL.bit_count()

    wait_until(fed, "all fed", WITHIN_S)


def estop() -> str:
    """An emergency stop takes all supply, and its answer says that the board has confirmed it."""
    with robot_with_board() as (ours, theirs):
        started(ours, theirs)
        ack = ours.client.estop()
        assert theirs.fed == 0
        assert ack.confirmed, f"the answer says confirmed: {ack.confirmed}"
        ours.client.reset()
        assert theirs.fed == 0, "a reset feeds nothing"
        started(ours, theirs)
    return f"confirmed {ack.confirmed_ms:.0f} ms after it was asked for, under emulation; fed again by a start"


def others() -> str:
    """Another program on this computer sends a mask; then `stop-servos` does, and the gateway is killed."""
    with robot_with_board() as (ours, theirs):
        started(ours, theirs)
        with can.Bus(channel=OURS, interface="socketcan", ignore_config=True) as bus:
            mask = set_supply(ALL & ~1)
            bus.send(can.Message(arbitration_id=mask.id, is_extended_id=False, data=mask.data))
        wait_until(
            lambda: any("another program" in each.detail for each in ours.events("power_fault")), "its event", WITHIN_S
        )
        wait_until(lambda: not theirs.fed & 0b111, "the leg whose servo it took is off", WITHIN_S)
        ours.gateway.child.kill()
        command = [sys.executable, "-m", "gateway", "stop-servos", "--config", str(ours.gateway.config)]
        with Child(command, os.environ) as child:
            code = child.wait(WITHIN_S)
        assert (code, theirs.fed) == (0, 0), f"exit code {code}, {theirs.fed:#x} is fed: {child}"
    return "its mask is reported; with the gateway killed, stop-servos takes all supply, and it is confirmed"


def down() -> str:
    """The interface is switched off while legs run, and on again."""
    with robot_with_board() as (ours, theirs):
        started(ours, theirs)
        link("set", OURS, "down")
        wait_until(lambda: bool(ours.events("power_unconfirmed")), "the event", WITHIN_S)
        detail = ours.events("power_unconfirmed")[0].detail
        wait_until(lambda: not servos_on(ours.client.state()), "all stopped", WITHIN_S)
        link("set", OURS, "up")
        until_alive(ours)
        assert not servos_on(ours.client.state()), "a start is needed"
        assert theirs.fed == 0
    return f"{detail}; what ran is stopped; once it is up nothing is fed, and nothing runs"
