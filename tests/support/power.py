"""A robot with a power board in virtual time: the real rules of both sides, and a line that takes no time."""

import asyncio
from collections.abc import Callable, Sequence
from typing import Any, Final, cast

from gateway.rate_limit import NS_PER_S
from gateway.robot.power.board import Confirmed, News, Status
from gateway.robot.power.line import SHOWN, PowerLine
from gateway.robot.service import BEAT_S
from tests.support.elkapod import ElkapodRobot
from tests.support.power_link import Link
from tests.support.robot import Robot

PUMP_NS: Final = 500_000


class VirtualLine(Link):
    """The line's threads as a timer of the loop, on which frames take no time."""

    def __init__(self, loop: asyncio.AbstractEventLoop, outputs: Sequence[int], confirm_ms: float) -> None:
        super().__init__(outputs=outputs, confirm_ms=confirm_ms, flight_ns=0, look_ns=PUMP_NS)
        self._loop = loop
        self.listens = True
        self.on_news: Callable[[list[News | Confirmed]], None] = lambda _: None
        self._status = Status()
        self._pump()

    def catch_up(self) -> None:
        self.run_to(round(self._loop.time() * 1e9))

    # ---- the line's side

    @property
    def status(self) -> Status:
        return self._status

    @property
    def polled_ns(self) -> int:
        return round(self._loop.time() * 1e9) if self.listens else 0

    def _pump(self) -> None:
        self.catch_up()
        before, self._status = self._status, self.ours.status
        news = [item for _, item in self.told]
        self.told.clear()
        if news or before[SHOWN] != self._status[SHOWN]:
            self.on_news(news)
        self._loop.call_later(PUMP_NS / NS_PER_S, self._pump)


def running(robot: Robot) -> list[int]:
    """The servos that run, as the state says it."""
    return [each.id for leg in robot.state().legs for each in leg.servos if each.running]


class _Fed(Robot):
    line: VirtualLine

    def __init__(self, **sections: dict[str, Any]) -> None:
        super().__init__({"power": {"interface": "sim", **sections.pop("power", {})}, **sections})

    def power_line(self) -> PowerLine:
        power = self.settings.power
        self.line = VirtualLine(self.loop, power.outputs, power.confirm_ms)
        self.loop.call_later(BEAT_S, self._check)
        return cast(PowerLine, self.line)

    def _check(self) -> None:
        """The service's."""
        self.conductor.check_outside()
        self.loop.call_later(BEAT_S, self._check)


class FedRobot(_Fed):
    """A robot of hexapod-1.0 with a power board; its service has begun."""

    def __init__(self, **sections: dict[str, Any]) -> None:
        super().__init__(**sections)
        self.conductor.start()
        self.conductor.reports.announce_start()


class FedElkapod(_Fed, ElkapodRobot):
    """A robot of elkapod-2025 with a power board: each servo starts and stops by its supply."""
