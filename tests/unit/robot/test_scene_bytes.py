"""One fixed scene in virtual time, and every transfer of it: what no change of names, rooms or words may change."""

import asyncio
from pathlib import Path

import async_solipsism
import pytest

from gateway.model.frames import Framing
from schemas import keys
from schemas.robot import LEGS
from tests.support.robot import MS, Robot, leg, servo


@pytest.mark.parametrize("framing", Framing)
def test_the_bytes_of_a_scene_are_those_that_were_recorded(framing: Framing) -> None:
    assert transfers(framing) == path(framing).read_text().splitlines()


def test_where_a_kernel_takes_no_lists_they_are_the_same() -> None:
    """In `plain`; zeros that are written one by one take time here."""
    assert transfers(Framing.PLAIN, lists=False) == path(Framing.PLAIN).read_text().splitlines()


FOLDER = Path(__file__).parents[2] / "data" / "scene"


async def _play(framing: Framing, *, lists: bool) -> Robot:
    """Play the start, streams above and below the rate, Stops of each kind, a fault, the end."""
    robot = Robot({"spi": {"framing": framing}, "limits": {"start_stagger_ms": 5, "takeover_deg_s": 0}})
    if not lists:
        robot.take_no_lists()
    robot.conductor.start()
    robot.conductor.reports.announce_start()
    await asyncio.sleep(0.03)  # among the repeats of the first Stops
    robot.put(keys.LEGS_COMMAND, {"legs": {str(number): leg("start", 90, 45.25, 120) for number in LEGS}})
    for step in range(8):  # leg 1 is commanded above its rate, leg 2 below it
        robot.put(keys.leg_command(1), leg("set", 90 + step, 45.25, 120.01))
        robot.put(keys.servo_command(22), servo("set", 180 - step)) if step % 4 == 0 else None
        await asyncio.sleep(0.007)
    robot.put(keys.servo_command(32), servo("stop"))
    robot.put(keys.leg_command(4), leg("stop"))
    await asyncio.sleep(0.6)  # the watchdog stops what is left, and repeats it
    robot.put(keys.leg_command(6), leg("start", 0, 90, 180))
    robot.put(keys.ESTOP)
    robot.put(keys.leg_command(6), leg("start", 0, 90, 180))  # rejected
    await asyncio.sleep(0.1)
    robot.put(keys.RESET, {"estop": 1})
    robot.controller.fail_next(1)
    robot.put(keys.leg_command(5), leg("start", 5, 6, 7))
    await asyncio.sleep(0.2)  # opened again
    robot.put(keys.servo_command(53), servo("start", 6.14))
    robot.conductor.shut_down()
    await asyncio.sleep(0.2)
    return robot


def transfers(framing: Framing, *, lists: bool = True) -> list[str]:
    """Return each transfer of the scene as a line: when, in ms, and its bytes in hexadecimal."""
    loop = async_solipsism.EventLoop()
    try:
        robot = loop.run_until_complete(_play(framing, lists=lists))
    finally:
        loop.close()
    return [f"{at_ns / MS:.3f} {data.hex()}" for at_ns, data in robot.controller.transfers]


def path(framing: Framing) -> Path:
    return FOLDER / f"{framing}.txt"


def main() -> None:
    FOLDER.mkdir(parents=True, exist_ok=True)
    for framing in Framing:
        path(framing).write_text("\n".join(transfers(framing)) + "\n")


if __name__ == "__main__":
    main()
