"""A robot with a power board in virtual time: the real rules of both sides, and a line that takes no time."""

import asyncio
from collections.abc import Callable, Mapping
from typing import Any, Final, cast

from gateway.model.power_board import SET_SUPPLY, CanFrame
from gateway.robot.power.board import News, PowerBoard, Status
from gateway.robot.power.line import PowerLine
from gateway.robot.power.offs import Confirmed
from gateway.robot.runtime.supply import RobotSupply
from gateway.robot.service import BEAT_S
from gateway.simulation.board import SimulatedBoard
from tests.support.elkapod import ElkapodRobot
from tests.support.robot import MS, Robot

PUMP_S: Final = 0.0005


class VirtualLine:
    """The line's threads as a timer of the loop. `unplugged`: nothing passes, either way; `deaf`: masks are lost."""

    def __init__(self, loop: asyncio.AbstractEventLoop, outputs: tuple[int, ...], confirm_ns: int) -> None:
        self._loop = loop
        self._outputs = outputs
        self.board = PowerBoard(outputs, confirm_ns=confirm_ns)
        self.simulated = SimulatedBoard()
        self.second: SimulatedBoard | None = None
        """Another board on the same bus."""
        self.unplugged = False
        self.deaf = False
        self.listens = True
        self.hears = True
        """Whether we hear the board; it hears us all the same."""
        self.sent: list[tuple[int, CanFrame]] = []
        """With its time (ms)."""
        self.on_news: Callable[[], None] = lambda: None
        self._status = Status()
        self._news: list[News | Confirmed] = []
        self._pump()

    def now_ns(self) -> int:
        return round(self._loop.time() * 1e9)

    @property
    def fed(self) -> frozenset[int]:
        """What the board really feeds."""
        return frozenset(servo for place, servo in enumerate(self._outputs) if self.simulated.fed >> place & 1)

    def hear_from_another(self, frame: CanFrame) -> None:
        """Another node sends this."""
        self._hear([frame, *self._taken(frame)])

    def _taken(self, frame: CanFrame) -> list[CanFrame]:
        boards = [self.simulated] if self.second is None else [self.simulated, self.second]
        return [answer for board in boards for answer in board.take(frame, self.now_ns())]

    # ---- the line's side

    @property
    def status(self) -> Status:
        return self._status

    @property
    def polled_ns(self) -> int:
        return self.now_ns() if self.listens else 0

    def want(self, servos: frozenset[int], number: int) -> None:
        self.board.want(servos, number, self.now_ns())
        self._send()

    def cut(self) -> None:
        self.board.cut(self.now_ns())
        self._send()

    def when_off(self, servos: frozenset[int], asked_ns: int, token: int) -> None:
        self.board.when_off(servos, asked_ns, token, self.now_ns())
        self._send()

    def clear_errors(self) -> None:
        self.board.clear_errors(self.now_ns())

    def news(self) -> list[News | Confirmed]:
        news, self._news = self._news, []
        return news

    def close(self) -> None:
        self._send()

    # ---- its threads

    def _send(self) -> None:
        for frame in self.board.next_frames(self.now_ns()):
            self.sent.append((self.now_ns() // MS, frame))
            lost = self.unplugged or (self.deaf and frame.id == SET_SUPPLY)
            self._hear([] if lost else self._taken(frame))

    def _hear(self, frames: list[CanFrame]) -> None:
        for frame in frames if self.hears and not self.unplugged else ():
            self.board.receive(frame, self.now_ns())

    def _pump(self) -> None:
        self._hear(self.simulated.advance(self.now_ns()))
        self._hear([] if self.second is None else self.second.advance(self.now_ns()))
        self._send()
        self.board.poll(self.now_ns())
        before, self._status = self._status, self.board.status
        self._news += self.board.news()
        if self._news or before[:7] != self._status[:7]:
            self._loop.call_soon(self.on_news)
        self._loop.call_later(PUMP_S, self._pump)


def running(robot: Robot) -> list[int]:
    """The servos that run, as the state says it."""
    return [each.id for leg in robot.conductor.reports.state().legs for each in leg.servos if each.running]


class FedRobot(Robot):
    """A robot of hexapod-1.0 with a power board; its service has begun."""

    line: VirtualLine

    def __init__(self, **sections: dict[str, Any]) -> None:
        super().__init__({"power": {"interface": "sim", **sections.pop("power", {})}, **sections})
        self.conductor.start()
        self.conductor.reports.announce_start()

    def supply(self) -> RobotSupply:
        return _feed(self, None)


class FedElkapod(ElkapodRobot):
    """A robot of elkapod-2025 with a power board: each servo starts and stops by its supply."""

    line: VirtualLine

    def __init__(self, **sections: dict[str, Any]) -> None:
        super().__init__({"power": {"interface": "sim", **sections.pop("power", {})}, **sections})

    def supply(self) -> RobotSupply:
        return _feed(self, self.cyclic.ready_servos)


def _feed(
    robot: FedRobot | FedElkapod, ready: Callable[[Mapping[int, int | None]], frozenset[int]] | None
) -> RobotSupply:
    power = robot.settings.power
    robot.line = VirtualLine(robot.loop, power.outputs, round(power.confirm_ms * MS))
    robot.line.want(frozenset(), 0)

    def beat() -> None:
        """The service's."""
        robot.conductor.check_outside()
        robot.loop.call_later(BEAT_S, beat)

    robot.loop.call_later(BEAT_S, beat)
    supply = RobotSupply(cast(PowerLine, robot.line), power.interface, ready)
    robot.line.on_news = lambda: supply.on_news()  # noqa: PLW0108  (it is set behind this)
    return supply
