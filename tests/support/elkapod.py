"""A robot of elkapod-2025 without Zenoh and in virtual time: conductor, cycle and a simulated controller."""

import asyncio
import struct
from collections.abc import Iterable, Mapping
from typing import Any

from gateway.model.elkapod import SHUTDOWN, START
from gateway.robot.spi import Wire
from gateway.robot.spi.cyclic import CYCLE_HZ, CyclicBus
from schemas.robot import LEGS, SERVO_IDS
from schemas.words import Kind
from tests.support.controllers import Elkapod
from tests.support.robot import MS, Robot, leg


class ElkapodRobot(Robot):
    """Its gateway has begun; frames go from then on."""

    def __init__(self, sections: Mapping[str, Mapping[str, Any]] | None = None) -> None:
        sections = sections or {}
        super().__init__({**sections, "wire": {"name": "elkapod-2025"}})
        self.conductor.start()
        self.conductor.reports.announce_start()
        self.loop.call_later(1 / CYCLE_HZ, self._go_on)

    def wire(self) -> Wire:
        self.elkapod = Elkapod(clock=self.now_ns)
        self.cyclic = CyclicBus(
            lambda: self.elkapod,
            lambda: self.elkapod,
            fed_singly=bool(self.settings.power.interface),
            clock=self.now_ns,
        )
        return self.cyclic

    def _go_on(self) -> None:
        self.cyclic.cycle(self.conductor.owner, self.conductor.measured, self.conductor.bus_failed)
        self.loop.call_later(1 / CYCLE_HZ, self._go_on)

    @property
    def said(self) -> list[tuple[float, str]]:
        """Return the UART's messages: when (ms), and what."""
        names = {START: "start", SHUTDOWN: "shutdown"}
        return [(at_ns / MS, names[message]) for at_ns, message in self.elkapod.messages]

    def kinds(self) -> list[Kind]:
        return [Kind(event.kind) for event in self.events()]


def angles_of(frame: bytes) -> dict[int, float]:
    assert (len(frame), frame[0], frame[-1]) == (80, 0x7E, 0x0F)
    return dict(zip(SERVO_IDS, struct.unpack_from("<18f", frame, 1), strict=True))


def all_legs(op: str, angle_deg: float | None = None, legs: Iterable[int] = LEGS) -> dict[str, Any]:
    angles_deg = () if angle_deg is None else (angle_deg,) * 3
    return {"legs": {str(number): leg(op, *angles_deg) for number in legs}}


async def elkapod(**sections: Mapping[str, Any]) -> ElkapodRobot:
    """Return one that has been up until nothing follows its first Stops, with nothing recorded yet."""
    robot = ElkapodRobot(sections)
    await asyncio.sleep(6)
    robot.elkapod.messages.clear()
    robot.elkapod.transfers.clear()
    robot.reports.clear()
    return robot
