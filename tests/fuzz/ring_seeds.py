"""What the fuzzers of the black box start from: what a gateway's own recorder wrote, in small rings."""

import asyncio
import logging
import os
import tempfile
from collections.abc import Awaitable, Callable
from functools import cache
from pathlib import Path
from typing import Final

import async_solipsism

from gateway.errors import SpiError
from gateway.model.black_box import format as form
from gateway.model.black_box import header
from gateway.model.black_box.files import RING_FILE
from gateway.model.frames import stop_leg
from gateway.robot.blackbox.ring import RecordRing
from schemas import keys
from tests.fuzz.ring_image import BODY, MAX_SLOTS, input_of
from tests.support.measured import MEASURED
from tests.support.robot import WALL_NS, Robot, leg

LEG_3: Final = keys.leg_command(3)
Written = list[tuple[int, int, bytes]]
"""Type, time and content of records."""


async def _silence(robot: Robot) -> None:
    """A leg is driven, and then silent."""
    robot.put(LEG_3, leg("start", 90, 45, 120, source="anna", sent_ms=1))
    await asyncio.sleep(0.1)
    robot.put(LEG_3, leg("set", 90, 46, 120, source="anna"))
    await asyncio.sleep(1)


async def _estop(robot: Robot) -> None:
    """An emergency stop, commands that are rejected or replaced, and a reset."""
    for angle in (90, 91, 92):
        robot.put(LEG_3, leg("start", angle, angle, angle, source="bert"))
    robot.put(LEG_3, b"{")
    robot.put(keys.ESTOP, {"source": "ä" * 64})
    robot.put(LEG_3, leg("start", 1, 1, 1))
    robot.put(keys.RESET, {"estop": 1})
    robot.put(
        keys.LEGS_COMMAND,
        {"legs": {str(each): leg("start", 90, 90, 90) for each in range(1, 7)}, "source": "somebody's name"},
    )
    await asyncio.sleep(0.01)


async def _bus_fault(robot: Robot) -> None:
    """The bus fails, and a mistake ends the gateway."""

    def fail(_: bytes) -> None:
        raise SpiError("Input/output error")

    setattr(robot.controller, "transfer", fail)  # noqa: B010  mypy takes it for a mistake
    robot.put(LEG_3, leg("start", 90, 45, 120))
    robot.conductor.recorder.mistake("a mistake in the gateway ended it: planted")


async def _end(robot: Robot) -> None:
    """A quiet gateway ends in order; its loop was late once."""
    robot.conductor.recorder.beat(20_000_000)
    await asyncio.sleep(2)
    robot.conductor.shut_down()
    robot.conductor.recorder.ended("asked to")


def _recorded(happens: Callable[[Robot], Awaitable[None]]) -> Written:
    """What a gateway records while this happens, as its ring has it."""

    async def run(folder: str) -> None:
        robot = Robot({"recorder": {"path": folder, "seconds": 10}})
        robot.conductor.start()
        robot.conductor.recorder.open()
        robot.conductor.announce_start()
        await happens(robot)
        robot.conductor.recorder.close()

    before = os.environ.get("RUNTIME_DIRECTORY")
    disabled = logging.root.manager.disable
    logging.disable()  # what happens is on purpose
    loop = async_solipsism.EventLoop()
    try:
        with tempfile.TemporaryDirectory() as folder:
            os.environ["RUNTIME_DIRECTORY"] = folder  # where its ring is to be
            loop.run_until_complete(run(folder))
            image = (Path(folder) / RING_FILE).read_bytes()
    finally:
        loop.close()
        logging.disable(disabled)
        os.environ.pop("RUNTIME_DIRECTORY")
        if before is not None:
            os.environ["RUNTIME_DIRECTORY"] = before
    written: Written = []
    for index in range(1, header.slots_of(image, len(image))):
        slot = form.read_slot(form.slot_bytes(image, index))
        if slot is None:
            break
        if slot.kind == form.MORE:
            kind, ns, rest = written.pop()
            written.append((kind, ns, rest + slot.rest))
        else:
            written.append((slot.kind, slot.ns, slot.rest))
    return written


def _ring(written: Written, slots: int) -> bytes:
    """The same in a ring of so many slots, which wraps around where they are more."""
    with tempfile.TemporaryDirectory() as folder:
        ring = RecordRing(Path(folder) / RING_FILE, slots)
        for kind, ns, rest in written:
            ring.append(kind, ns, rest)
        ring.close()
        return (Path(folder) / RING_FILE).read_bytes()


HOSTILE: Final[Written] = [
    (form.START, 1, form.start(WALL_NS, {"pid": "\ud800", "number": float("nan"), "none": None})),
    (form.START, 1, form.start(WALL_NS, {"nested": [None, {}]})),
    (form.COMMAND, 2, form.command(0, "put", "no key", "\x1b[2J", float("inf"), ())),
    (form.DECISION, 3, form.decision(0, "made up", "no key", "\u202e")),
    (form.FRAME, 4, form.frame(b"\xff" * 30, "made up", 1, 2**32 - 1, 7)),
    (form.FRAME, 4, form.frame(stop_leg(3).to_bytes(), "watchdog", 1, 2**32 - 1)),
    (form.EVENT, 5, form.event("watchdog_expired", "\x00", "\n", "'", "é" * 70, 2**32 - 1)),
    (form.LAG, 6, form.number(-(2**63))),
    (form.LEFT_OUT, 6, form.left_out(2**32 - 1, "\x1b[2J")),
    (form.LEFT_OUT, 6, form.left_out(1, None)[:-1]),
    (form.INCIDENT, 7, form.incident(2**62 - 1, "20260921-141320-123-watchdog")),
    (form.INCIDENT, 2**62 - 1, form.incident(0, "20260921-141320-123-estop")),
    (form.CLOCK, 8, form.number(0)),
    (form.CALIBRATION, 9, b'{"revision":1,"servos":{"31":{"trim_deg":7.5}},"landing":{"32":90}}'),
    (form.CALIBRATION, 9, b'{"revision":-1,"servos":{"77":{"trim_deg":1e999,"min_deg":9}},"landing":{"":NaN}}'),
    (form.ABOUT, 9, b'{"version":"9","limits":{"servos":[[[[{}]]]]}}'),
    (form.ABOUT, 9, b'{"version":NaN}'),
    (form.MEASURED, 10, form.measured(MEASURED)),
    (form.MEASURED, 10, form.measured(MEASURED._replace(voltage_v=float("nan")))),
    (form.MEASURED, 10, form.measured(MEASURED)[:-1]),
    (form.FRAME, 10, form.frame(stop_leg(3).to_bytes(), "watchdog", 1)),
]
"""What no recorder writes in this way."""


WINDOW: Final = 10
"""Records of a story in one ring: what a recorder writes together."""


@cache
def seeds() -> tuple[bytes, ...]:
    """Parts of each story, in rings that they fill in part, just fill, and wrap around."""
    found = []
    stories: list[Written] = [_recorded(happens) for happens in (_silence, _estop, _bus_fault, _end)]
    stories.append(HOSTILE)
    for written in stories:
        for begin in range(0, len(written), WINDOW // 2):
            # A gateway starts, so that there is a time of day.
            part = [written[0], *written[max(1, begin) : begin + WINDOW]]
            for number, slots in enumerate((len(part) + 5, len(part) + 1, max(4, len(part) * 2 // 3))):
                found.append(input_of(_ring(part, slots), number))
    torn = bytearray(found[0])
    torn[-form.SLOT * 3 + 30] ^= 1
    found += [bytes(torn), found[0][:-5], found[0] + b"\0" * 7, input_of(header.new(3), 0), b"\0"]
    assert all(len(each) <= BODY + MAX_SLOTS * form.SLOT for each in found)
    return tuple(found)
