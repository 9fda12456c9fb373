"""The line to the power board: by slcan on a pseudo terminal, and by interfaces that fail as CAN does."""

import asyncio
import errno
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import can
import pytest

from gateway.errors import ConfigError
from gateway.host.settings_table import PowerSettings
from gateway.model.power_board import CanFrame
from gateway.robot.power.board import Confirmed, News
from gateway.robot.power.interface import LineError, open_bus
from gateway.robot.power.line import PowerLine
from schemas.robot import SERVO_IDS
from schemas.words import Kind
from tests.support.boards import Adapter, BoardBus
from tests.support.robot import Robot
from tests.support.waiting import wait_until

ALL_SERVOS = frozenset(SERVO_IDS)
MOST_S = 20
"""No test takes so long unless something is wrong."""


class Owner:
    """A line and what it has reported. Its interface is each of `buses` in turn; without any, that of the settings."""

    def __init__(self, *buses: BoardBus, interface: str = "slcan", channel: str = "") -> None:
        settings, left = PowerSettings(interface, channel, confirm_ms=2000), list(buses)

        def opener(settings: PowerSettings) -> can.BusABC:
            if not left:
                raise LineError(settings.channel)
            return left.pop(0)

        self.news: list[News | Confirmed] = []
        self.mistakes: list[Exception] = []
        self.was_alive = False
        """Whether the board was alive once. A single answer does not last until a busy machine runs the test again."""
        self._something = threading.Condition()
        self.line = PowerLine(settings, self.mistakes.append, opener=opener if buses else open_bus)
        self.line.on_news = self._reported

    def _reported(self, news: list[News | Confirmed]) -> None:
        with self._something:
            self.news += news
            self.was_alive |= self.line.status.alive
            self._something.notify_all()

    def until(self, done: Callable[[], bool]) -> None:
        with self._something:
            assert self._something.wait_for(done, MOST_S), (self.news, self.line.status)

    def reported(self, *kinds: str) -> list[News]:
        return [item for item in self.news if isinstance(item, News) and item.kind in kinds]

    def until_reported(self, kind: Kind) -> News:
        self.until(lambda: bool(self.reported(kind)))
        return self.reported(kind)[0]

    def feed_all(self) -> None:
        """Feed all servos. Ask again if the board seems silent: the adapter's thread may be late."""
        while self.line.status.supplied != ALL_SERVOS:
            self.line.request(lambda board, now_ns: board.want(frozenset(), 0, now_ns))
            self.line.request(lambda board, now_ns: board.want(ALL_SERVOS, 0, now_ns))
            known = len(self.news)
            self.until(lambda: self.line.status.supplied == ALL_SERVOS or len(self.news) > known)  # noqa: B023

    def cut_and_confirm(self) -> Confirmed:
        self.line.cut()
        self.line.request(lambda board, now_ns: board.when_off(ALL_SERVOS, now_ns, lambda _: None, now_ns))
        self.until(lambda: any(isinstance(item, Confirmed) for item in self.news))
        return next(item for item in self.news if isinstance(item, Confirmed))


@pytest.fixture
def adapter(tmp_path: Path) -> Iterator[Adapter]:
    adapter = Adapter(str(tmp_path / "adapter"))
    yield adapter
    adapter.unplug()


@pytest.mark.lengthy
def test_junk_from_the_adapter_changes_nothing(tmp_path: Path, adapter: Adapter) -> None:
    owner = Owner(channel=str(tmp_path / "adapter"))
    owner.line.start()
    owner.feed_all()
    for junk in (
        b"\a\r\r\a",
        b"t06B2000\r",  # cut short
        b"t06B20000\r",  # wrong length
        b"t06B9000000000000000000\r",
        b"t06B3zzzzzz\r",
        b"T0000006B3000000\r",  # another frame's identifier
        b"r06B3\r",
        b"F04\r",
        bytes(range(256)) * 20,
        b"t" * 4000,
        b"\r",
    ):
        adapter.say(junk)
    assert owner.cut_and_confirm().ms is not None
    assert not owner.reported("power_fault", "off_button")
    owner.line.close()
    assert owner.mistakes == []


@pytest.fixture
def bus() -> Iterator[BoardBus]:
    bus = BoardBus(silent=True)
    yield bus
    bus.hangs.set()


def started(*buses: BoardBus) -> Owner:
    """Return the owner of a line that receives from the first of these interfaces."""
    owner = Owner(*buses)
    buses[0].answer(0x69)
    owner.line.start()
    owner.until_reported(Kind.OFF_BUTTON)
    return owner


@pytest.mark.lengthy
def test_a_sender_that_hangs_delays_no_caller_and_no_report(bus: BoardBus) -> None:
    owner = started(bus)
    bus.hangs.clear()
    owner.until_reported(Kind.POWER_UNCONFIRMED)
    assert not owner.line.status.alive
    for _ in range(1000):
        owner.line.request(lambda board, now_ns: board.want(ALL_SERVOS, 0, now_ns))
        owner.line.cut()
    assert owner.cut_and_confirm().ms is None
    polled_ns = owner.line.polled_ns
    owner.line.close(timeout_s=0.01)
    assert polled_ns > 0
    bus.hangs.set()


def test_error_frames_and_our_own_echo_are_no_answers(bus: BoardBus) -> None:
    owner = Owner(bus)
    bus.answer(0x69, is_error_frame=True)
    bus.answer(0x69, is_remote_frame=True)
    bus.answer(0x69, is_extended_id=True)
    bus.answer(0x6A, bytes(3), is_rx=False)
    bus.answer(0x97)
    owner.line.start()
    owner.until(lambda: owner.was_alive)
    assert not owner.reported("power_fault", "off_button")
    owner.line.close()


def test_on_socketcan_what_another_program_on_this_computer_sends_is_no_echo(bus: BoardBus) -> None:
    """`stop-servos`, say: the kernel marks its frames as sent here, and python-can gives our own ones to nobody."""
    owner = Owner(bus, interface="socketcan")
    bus.answer(0x6A, bytes(3), is_rx=False)
    owner.line.start()
    assert "another program" in owner.until_reported(Kind.POWER_FAULT).detail
    owner.line.close()


@pytest.mark.parametrize(
    "fault", [can.CanOperationError("No buffer space available"), RuntimeError("an exception of its own")]
)
def test_an_interface_that_fails_is_closed_and_opened_again_and_the_mask_leaves_again(fault: Exception) -> None:
    first, second = BoardBus(silent=True), BoardBus()
    owner = started(first, second)
    first.fails = fault
    owner.line.cut()
    owner.until(lambda: any(str(fault) in news.detail for news in owner.reported(Kind.POWER_UNCONFIRMED)))
    assert first.closed.wait(MOST_S)
    owner.until(lambda: owner.was_alive)
    owner.line.close()
    assert CanFrame(0x6A, bytes(3)) in second.sent
    assert second.closed.is_set()
    assert owner.mistakes == []


def test_an_interface_that_hangs_at_its_end_keeps_the_receiver_from_nothing(bus: BoardBus) -> None:
    """Else the service would end, since its thread that receives from the board counted as stuck."""
    owner = started(bus)
    bus.hangs.clear()
    bus.fails = OSError(errno.ENODEV, "No such device")
    owner.line.cut()
    assert bus.closed.wait(MOST_S)
    closed_ns = time.monotonic_ns()
    wait_until(lambda: owner.line.polled_ns >= closed_ns)
    bus.hangs.set()
    owner.line.close()


def test_a_full_transmit_queue_ends_nothing_and_the_mask_of_a_stop_leaves_first_once_there_is_room(
    bus: BoardBus,
) -> None:
    owner = Owner(bus)
    bus.answer(0x97)
    owner.line.start()
    owner.until(lambda: owner.was_alive)
    bus.fails = can.CanOperationError("Failed to transmit: No buffer space available", errno.ENOBUFS)
    owner.line.cut()
    tried = bus.tries
    wait_until(lambda: bus.tries >= tried + 3)
    sent = len(bus.sent)
    bus.fails = None
    wait_until(lambda: len(bus.sent) > sent)
    assert bus.sent[sent] == CanFrame(0x6A, bytes(3))
    assert not bus.closed.is_set()
    owner.line.close()
    assert owner.mistakes == []


def test_an_interface_that_opens_and_sends_nothing_is_opened_ten_times_a_second_at_most() -> None:
    """The bus is off. The sender has a real-time priority, and would keep others off the processor."""
    buses = [BoardBus(silent=True) for _ in range(6)]
    for bus in buses:
        bus.fails = can.CanOperationError("bus off")
    owner = Owner(*buses)
    begun_s = time.monotonic()
    owner.line.start()
    assert buses[-1].closed.wait(MOST_S)
    assert time.monotonic() - begun_s >= 0.4
    owner.line.close()


def test_a_mistake_in_the_gateway_is_reported(bus: BoardBus) -> None:
    owner = Owner(bus)
    bus.answer(0x97)
    owner.line.on_news = lambda _: 1 / 0  # type: ignore[assignment]
    owner.line.start()
    wait_until(lambda: bool(owner.mistakes))
    owner.line.close()
    assert isinstance(owner.mistakes[0], ZeroDivisionError)


def test_an_interface_that_never_opens_is_an_error_of_the_settings(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ConfigError, match=r"power\.interface"):
        Owner(interface="nonsense").line.start()
    with pytest.raises(LineError, match="cannot be opened"):
        open_bus(PowerSettings(interface="slcan", channel="/dev/none"))
    with pytest.raises(LineError, match="cannot be opened"):
        open_bus(PowerSettings(interface="socketcan", channel="none"))
    monkeypatch.setitem(sys.modules, "can", None)
    with pytest.raises(ConfigError, match="not installed"):
        open_bus(PowerSettings(interface="slcan"))


def test_an_adapter_that_reads_nothing_is_an_error_and_hangs_nobody(tmp_path: Path, adapter: Adapter) -> None:
    bus = open_bus(PowerSettings(interface="slcan", channel=str(tmp_path / "adapter")))
    adapter.pause()
    message = can.Message(arbitration_id=0x6A, is_extended_id=False, data=bytes(3))

    def fill() -> None:
        for _ in range(10_000):
            bus.send(message, timeout=0.01)

    with pytest.raises(can.CanOperationError, match="accepts nothing"):
        fill()
    adapter.go_on()
    bus.shutdown()


async def test_the_first_mask_switches_all_off_and_news_come_on_the_loop_with_the_state(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    channel = str(tmp_path / "can")
    adapter = Adapter(channel)
    mistakes: list[Exception] = []
    line = PowerLine(PowerSettings("slcan", channel, confirm_ms=2000), mistakes.append)
    monkeypatch.setattr(Robot, "power_line", lambda _: line)
    conductor = Robot({"power": {"interface": "sim"}}).conductor
    confirmed = asyncio.Event()
    publish = conductor.reports.publish

    def published() -> None:
        assert conductor.owner._state.locked()
        publish()
        if line.status.confirmed:
            confirmed.set()

    monkeypatch.setattr(conductor.reports, "publish", published)
    conductor.start()
    line.start()
    await asyncio.wait_for(confirmed.wait(), 10)
    report = conductor.reports.power()
    assert report is not None
    assert (report.interface, report.alive, report.supplied) == ("sim", True, ())
    masks = [each for each in adapter.received if each.startswith(b"t06A")]
    assert set(masks) == {b"t06A3000000"}
    await asyncio.to_thread(line.close, 10)
    assert not line._sender.is_alive()
    assert not line._receiver.is_alive()
    assert mistakes == []
    adapter.unplug()
