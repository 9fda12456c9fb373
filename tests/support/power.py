"""A power board and the gateway's side of it on one CAN link, in virtual time; and a robot that has them."""

import asyncio
from collections.abc import Callable, Iterator, Sequence
from heapq import heappop, heappush
from itertools import count
from typing import Any, Final, cast

from gateway.model.power_board import SET_SUPPLY, CanFrame
from gateway.rate_limit import NS_PER_MS, NS_PER_S
from gateway.robot.power.board import Confirmed, News, PowerBoard, Status
from gateway.robot.power.line import SHOWN, PowerLine
from gateway.robot.service import BEAT_S
from gateway.simulation.board import SimulatedBoard
from schemas.robot import SERVO_IDS
from schemas.words import Kind
from tests.support.robot import ElkapodRobot, Robot

ALL_SERVOS = frozenset(SERVO_IDS)
NONE: frozenset[int] = frozenset()
CONFIRM_MS = 150
FLIGHT_NS = 200_000
"""How long a frame is on its way, with an adapter on USB."""
LOOK_NS = 10 * NS_PER_MS
MOST_AT_ONCE = 1000
"""Events without any time between them: more are a side that is due for ever."""


class Link:
    """A CAN link that carries frames both ways, and calls each side when it is due."""

    def __init__(
        self,
        *,
        outputs: Sequence[int] = SERVO_IDS,
        pass_ns: int = 1_500_000,
        confirm_ms: float = CONFIRM_MS,
        flight_ns: int = FLIGHT_NS,
        look_ns: int = LOOK_NS,
    ) -> None:
        self.now_ns = 0
        self.ours = PowerBoard(tuple(outputs), confirm_ns=round(confirm_ms * NS_PER_MS))
        self.board = SimulatedBoard(pass_ns=pass_ns)
        self.altered: Callable[[CanFrame], CanFrame] = lambda frame: frame
        """Returns what the gateway receives in place of an answer."""
        self.hangs = False
        """Whether the gateway's sender hangs: nobody asks what is due."""
        self.cable = True
        self.deaf = False
        """The board answers questions, and gets no mask."""
        self.second: SimulatedBoard | None = None
        """A second board on the bus."""
        self.hears = True
        """Whether the gateway receives from the board, which always receives from the gateway."""
        self.sent: list[tuple[int, CanFrame]] = []
        """The gateway's frames, with their times."""
        self.told: list[tuple[int, News | Confirmed]] = []
        self._outputs, self._flight_ns, self._between_ns = outputs, flight_ns, look_ns
        self._flying: list[tuple[int, int, bool, CanFrame]] = []
        self._order = count()
        self._look_ns = 0
        self._at_once = 0

    # ---- what happened

    def masks(self, since_ns: int = 0) -> list[tuple[float, int]]:
        """Return the masks that we sent: milliseconds since then, and mask."""
        found = ((at_ns, frame) for at_ns, frame in self.sent if frame.id == 0x6A and at_ns >= since_ns)
        return [((at_ns - since_ns) / NS_PER_MS, int.from_bytes(frame.data, "big")) for at_ns, frame in found]

    def events(self, kind: Kind) -> list[tuple[int, News]]:
        return [(at_ns, item) for at_ns, item in self.told if isinstance(item, News) and item.kind == kind]

    def confirmations(self) -> Iterator[Confirmed]:
        return (item for _, item in self.told if isinstance(item, Confirmed))

    def fed(self) -> frozenset[int]:
        """Return the servos that have supply, in truth."""
        return frozenset(servo for place, servo in enumerate(self._outputs) if self.board.fed >> place & 1)

    # ---- what the owner does

    def want(self, servos: frozenset[int]) -> None:
        self.request(lambda board, now_ns: board.want(servos, 0, now_ns))

    def cut(self) -> None:
        self.request(PowerBoard.cut)

    def clear_errors(self) -> None:
        self.request(PowerBoard.clear_errors)

    def when_off(self, servos: frozenset[int]) -> None:
        self.request(lambda board, now_ns: board.when_off(servos, now_ns, lambda _: None, now_ns))

    def request(self, act: Callable[[PowerBoard, int], object]) -> None:
        self.catch_up()
        act(self.ours, self.now_ns)
        self.catch_up()

    def catch_up(self) -> None:
        """Do nothing: what is due before and after a call happens when the test runs the link."""

    # ---- time

    def run(self, ms: float) -> None:
        """Let so much time pass."""
        self.run_to(self.now_ns + round(ms * NS_PER_MS))

    def run_to(self, end_ns: int) -> None:
        """Let time pass until then."""
        while (at_ns := self._next_ns()) <= end_ns:
            self._go_to(at_ns)
        self.now_ns = end_ns

    def run_until(self, done: Callable[[], bool], most_ms: float = 3000) -> float:
        """Run until `done`, and return after how many milliseconds."""
        begun_ns = self.now_ns
        while not done():
            assert self.now_ns - begun_ns < most_ms * NS_PER_MS
            self._go_to(self._next_ns())
        return (self.now_ns - begun_ns) / NS_PER_MS

    def hear_from_another(self, frame: CanFrame) -> None:
        """Send a frame from another node on the bus: all boards and the gateway receive it."""
        self.catch_up()
        self._taken(frame)
        if self.cable and self.hears:
            self.ours.receive(frame, self.now_ns)
        self.catch_up()

    @property
    def _boards(self) -> list[SimulatedBoard]:
        return [self.board] if self.second is None else [self.board, self.second]

    def _next_ns(self) -> int:
        due_ns = [*(board.due_ns for board in self._boards), self._look_ns]
        if not self.hangs:
            due_ns.append(self.ours.due_ns)
        if self._flying:
            due_ns.append(self._flying[0][0])
        return min(due_ns)

    def _go_to(self, at_ns: int) -> None:
        self._at_once = 0 if at_ns > self.now_ns else self._at_once + 1
        assert self._at_once < MOST_AT_ONCE
        self.now_ns = max(self.now_ns, at_ns)
        self._happen()

    def _happen(self) -> None:
        while self._flying and self._flying[0][0] <= self.now_ns:
            _, _, to_board, frame = heappop(self._flying)
            if not to_board:
                self.ours.receive(frame, self.now_ns)
            elif not (self.deaf and frame.id == SET_SUPPLY):
                self._taken(frame)
        for board in self._boards:
            self._answered(board.advance(self.now_ns))
        if self.now_ns >= self._look_ns:
            self._look_ns = self.now_ns + self._between_ns
            self.ours.poll(self.now_ns)
        if not self.hangs and self.now_ns >= self.ours.due_ns:
            for frame in self.ours.next_frames(self.now_ns):
                self.sent.append((self.now_ns, frame))
                if self.cable:
                    heappush(self._flying, (self.now_ns + self._flight_ns, next(self._order), True, frame))
        self.told += [(self.now_ns, item) for item in self.ours.news]
        self.ours.news.clear()

    def _taken(self, frame: CanFrame) -> None:
        for board in self._boards:
            self._answered(board.take(frame, self.now_ns))

    def _answered(self, frames: list[CanFrame]) -> None:
        for frame in frames:
            if self.cable and self.hears:
                heappush(self._flying, (self.now_ns + self._flight_ns, next(self._order), False, self.altered(frame)))


def fed() -> Link:
    """Return a link whose board feeds all servos, and is at rest."""
    link = Link()
    link.want(ALL_SERVOS)
    link.run(1500)
    assert link.fed() == link.ours.status.supplied == ALL_SERVOS
    assert link.ours.alive
    link.told.clear()
    return link


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
    """Return the servos that run, as the state says it."""
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
        """Beat as the service does."""
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
