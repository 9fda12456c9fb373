"""elkapod-2025 from a command to the controller's servos, in virtual time; and its UART by pyserial."""

import asyncio
import os
import tty
from collections.abc import Iterator
from typing import Any

import pytest

from gateway.errors import SpiError
from gateway.model import elkapod as wire
from gateway.model.elkapod import SHUTDOWN
from gateway.robot.spi.uart import SerialUart
from schemas import keys
from schemas.words import Kind, Mode
from tests.support.robot import ElkapodRobot, all_legs, angles_of, elkapod, leg

pytestmark = pytest.mark.virtual_time


START = all_legs("start", 80)


async def walking(**sections: dict[str, object]) -> ElkapodRobot:
    """Run all servos, and command their legs from now on."""
    robot = await elkapod(**sections)
    assert robot.ask(keys.LEGS_COMMAND, START).accepted
    await asyncio.sleep(0.1)
    assert len(robot.elkapod.energised) == 18
    robot.elkapod.messages.clear()
    return robot


def angles(robot: ElkapodRobot, last: int) -> list[set[float]]:
    """Return what the last frames say."""
    return [set(angles_of(data).values()) for _, data in list(robot.elkapod.transfers)[-last:]]


STOPS: dict[str, tuple[str, object] | None] = {
    "a stop of one leg": (keys.leg_command(3), leg("stop")),
    "a stop of one servo": (keys.servo_command(42), {"op": "stop"}),
    "a stop of all": (keys.LEGS_COMMAND, all_legs("stop")),
    "the emergency stop": (keys.ESTOP, {}),
    "the end": None,
}


@pytest.mark.parametrize("stop", STOPS)
async def test_any_stop_shuts_down_at_once_and_is_repeated(stop: str) -> None:
    robot = await walking()
    command = STOPS[stop]
    assert robot.conductor.shut_down() if command is None else robot.ask(*command).accepted
    assert [what for _, what in robot.said] == ["shutdown"]
    assert not robot.elkapod.energised
    await asyncio.sleep(0.15)
    assert [what for _, what in robot.said] == ["shutdown"] * 4
    assert all(not each.running for leg in robot.state().legs for each in leg.servos)
    assert angles(robot, 3) == [{80.0}] * 3, "should the shutdown be lost, they hold where they are"


@pytest.mark.parametrize("fault", ["silent", "frozen", "garbage"])
async def test_a_silent_controller_is_a_fault_and_nothing_runs_when_it_is_back(fault: str) -> None:
    robot = await walking(watchdog={"timeout_ms": 5000})
    setattr(robot.elkapod, fault, wire.answer(robot.elkapod._measure(0))[1:] + b"\0" if fault == "garbage" else True)
    await asyncio.sleep(0.9)
    restarted = robot.events(Kind.CONTROLLER_RESTARTED)
    assert len(restarted) == (0 if fault == "frozen" else 1), "which it may be, until it stays away"
    (event,) = robot.events(Kind.CONTROLLER_SILENT)
    assert ("heartbeat" if fault == "silent" else "well-formed answer") in event.detail
    assert robot.mode == Mode.BUS_FAULT
    assert not robot.elkapod.energised
    assert robot.state().controller.alive is False
    assert robot.ask(keys.LEGS_COMMAND, START).reason == "bus_fault"
    assert robot.ask(keys.ESTOP, {}).accepted
    setattr(robot.elkapod, fault, None if fault == "garbage" else False)
    await asyncio.sleep(0.5)
    assert robot.events(Kind.CONTROLLER_RETURNED)
    assert not robot.events(Kind.BUS_RECOVERED)
    assert robot.mode == Mode.ESTOPPED
    assert "start" not in [what for _, what in robot.said]


HALF = wire.answer(wire.Measured(30, 8, 80, (1, 0, 0, 0), (0,) * 3, (0, 0, 9.81), (0,) * 6))[:40] + bytes(40)
RESTARTS: dict[str, dict[str, Any]] = {
    "at once, with garbage": {},
    "at once, in the middle of an answer": {"first_answer": HALF},
    "off for a cycle": {"off_ns": 20_000_000},
    "off for 250 ms": {"off_ns": 250_000_000},
}


@pytest.mark.parametrize("restart", RESTARTS)
@pytest.mark.parametrize("doing", ["walking", "starting", "idle", "estopped"])
async def test_a_controller_that_restarts_is_shut_down_and_moves_only_after_a_new_start(
    doing: str, restart: str
) -> None:
    robot = await elkapod(watchdog={"timeout_ms": 5000})
    if doing in {"walking", "starting"}:
        assert robot.ask(keys.LEGS_COMMAND, START).accepted
    if doing == "walking":
        await asyncio.sleep(0.1)
        assert len(robot.elkapod.energised) == 18
    elif doing == "estopped":
        assert robot.ask(keys.ESTOP, {}).accepted
        await asyncio.sleep(0.2)
    robot.elkapod.messages.clear()
    robot.elkapod.power_cycle(**RESTARTS[restart])
    await asyncio.sleep(0.045)
    assert [what for _, what in robot.said] or restart == "off for 250 ms", "a shutdown in the cycle that shows it"
    assert robot.mode == Mode.BUS_FAULT
    await asyncio.sleep(1)
    assert [event.kind for event in robot.events() if "controller" in str(event.kind)] == [
        Kind.CONTROLLER_RESTARTED,
        Kind.CONTROLLER_RETURNED,
    ]
    assert {what for _, what in robot.said} == {"shutdown"}
    assert robot.mode == (Mode.ESTOPPED if doing == "estopped" else Mode.IDLE)
    assert not any(each.running for leg in robot.state().legs for each in leg.servos)
    if doing != "estopped":
        assert robot.ask(keys.LEGS_COMMAND, all_legs("set", 81)).reason == "servo_stopped"
        assert robot.ask(keys.LEGS_COMMAND, START).accepted
        await asyncio.sleep(0.1)
        assert len(robot.elkapod.energised) == 18


@pytest.fixture
def ends() -> Iterator[tuple[int, str]]:
    """Yield the controller's end, and the path of the program's end."""
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    yield ours, os.ttyname(theirs)
    os.close(theirs)


def test_what_has_come_is_read_without_waiting_and_nothing_is_no_fault(ends: tuple[int, str]) -> None:
    ours, path = ends
    uart = SerialUart(path)
    uart.write(SHUTDOWN)
    assert os.read(ours, 100) == SHUTDOWN
    assert uart.read() == b""
    assert uart.read() == b""
    os.write(ours, b"beat")
    found = b""
    while found != b"beat":
        found += uart.read()
    assert uart.read() == b""
    with pytest.raises(SpiError, match="cannot be opened"):
        SerialUart(path)
    uart.close()
    SerialUart(path).close()
    os.close(ours)


def test_an_unplugged_uart_is_named(ends: tuple[int, str]) -> None:
    ours, path = ends
    uart = SerialUart(path)
    os.close(ours)
    with pytest.raises(SpiError, match=path):
        uart.read()
    with pytest.raises(SpiError, match=path):
        uart.write(SHUTDOWN)
    uart.close()
    with pytest.raises(SpiError, match=r"controller\.uart"):
        SerialUart(f"{path}9")
