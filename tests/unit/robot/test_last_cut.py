"""`stop-servos` takes the supply: what is confirmed, and that nothing on SPI is waited for."""

import gc
import random
import re
import threading
import time
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import pytest

from gateway.allowance import NS_PER_MS
from gateway.errors import ConfigError
from gateway.host.settings_table import PowerSettings
from gateway.model.power_board import ALL, ASK_RAILS, SET_SUPPLY, SUPPLIED, CanFrame, set_supply
from gateway.robot.power import last_cut
from gateway.robot.power.interface import LineError
from gateway.robot.power.last_cut import LastCut, SupplyCut
from gateway.simulation.board import SimulatedBoard
from tests.support.board_bus import BoardBus
from tests.support.slcan_adapter import Adapter

SETTINGS = PowerSettings("socketcan")
OFF = CanFrame(SUPPLIED, bytes(3))
REACHED = CanFrame(ASK_RAILS[0].id + 1, bytes(6))
STEP_NS = NS_PER_MS


def fed_board() -> SimulatedBoard:
    board = SimulatedBoard(-1_000 * NS_PER_MS)
    board.take(set_supply(ALL), -1_000 * NS_PER_MS)
    board.advance(0)
    return board


def test_it_is_confirmed_by_an_answer_behind_that_to_a_question_asked_after_the_mask() -> None:
    """A 6B that was on its way may be the answer to another mask of nothing, before somebody fed a servo again."""
    cut = LastCut()
    assert cut.next_frames(0)[:2] == [set_supply(0), ASK_RAILS[0]]
    cut.receive(OFF, 1)
    assert not cut.confirmed
    cut.receive(REACHED, 2)
    assert not cut.confirmed
    cut.receive(CanFrame(SUPPLIED, b"\0\0\1"), 3)
    assert not cut.confirmed
    cut.receive(CanFrame(SUPPLIED, b"\0\0"), 4)
    assert not cut.confirmed
    cut.receive(OFF, 5)
    assert cut.confirmed
    assert cut.next_frames(1_000 * NS_PER_MS) == []


@pytest.mark.parametrize("seed", range(40))
def test_beside_a_node_that_asks_and_switches_nothing_is_confirmed_before_a_mask_has_arrived(seed: int) -> None:
    """Of what we send next to nothing reaches the board, for up to a second; we receive all."""
    chance = random.Random(seed)  # noqa: S311
    cut, board, deaf_ms, reached = LastCut(), fed_board(), chance.randrange(1000), False
    for ms in range(2500):
        now_ns = ms * NS_PER_MS
        ours = [frame for frame in cut.next_frames(now_ns) if ms >= deaf_ms]
        reached = reached or any(frame.id == SET_SUPPLY for frame in ours)
        theirs = [chance.choice(ASK_RAILS)] if chance.random() < 0.2 else []
        theirs += [set_supply(chance.choice([0, ALL]))] if chance.random() < 0.02 and ms < 1500 else []
        for frame in theirs:
            cut.receive(frame, now_ns)
        for frame in (*ours, *theirs):
            for answer in board.take(frame, now_ns):
                cut.receive(answer, now_ns)
        for answer in board.advance(now_ns):
            cut.receive(answer, now_ns)
        assert reached or not cut.confirmed
    assert cut.confirmed


def test_what_two_boards_answer_confirms_nothing() -> None:
    """One of them may be unplugged, and feed servos while the other confirms."""
    cut, boards = LastCut(), (fed_board(), fed_board())
    for now_ns in range(0, 2_000 * NS_PER_MS, STEP_NS):
        for frame in cut.next_frames(now_ns):
            for answer in [answer for board in boards for answer in board.take(frame, now_ns)]:
                cut.receive(answer, now_ns)
    assert not cut.confirmed


def test_a_repeat_waits_for_5_ms_behind_an_answer() -> None:
    """In whose pass the board would take it 230 passes late."""
    cut = LastCut()
    cut.next_frames(0)
    cut.receive(OFF, 19 * NS_PER_MS)
    assert set_supply(0) not in cut.next_frames(24 * NS_PER_MS - 1)
    assert set_supply(0) in cut.next_frames(24 * NS_PER_MS)


@pytest.mark.parametrize("lost", [0, 1, 3, 10])
def test_masks_are_repeated_every_20_ms_until_the_board_has_one(lost: int) -> None:
    """The first ones never reach it; it is off at once then, and confirms it."""
    cut, board, masks = LastCut(), fed_board(), []
    for now_ns in range(0, 2_000 * NS_PER_MS, STEP_NS):
        for frame in cut.next_frames(now_ns):
            masks += [now_ns] if frame.id == SET_SUPPLY else []
            if len(masks) > lost:
                for answer in board.take(frame, now_ns):
                    cut.receive(answer, now_ns)
        for answer in board.advance(now_ns):
            cut.receive(answer, now_ns)
    assert cut.confirmed
    assert board.fed == 0
    assert all(b - a >= 20 * NS_PER_MS for a, b in pairwise(masks))
    assert masks[lost] == lost * 20 * NS_PER_MS


def told(bus: BoardBus, *, stops_written: bool = True) -> tuple[bool, list[tuple[str, bool]]]:
    """What it says, and returns."""
    said: list[tuple[str, bool]] = []
    cut = SupplyCut(SETTINGS, lambda sentence, confirmed: said.append((sentence, confirmed)), bus.opened)
    if stops_written:
        cut.stops_written()
    else:
        assert bus.first_sent.wait(10), "nothing was sent while the Stops on SPI hang"
    return cut.end(), said


def test_nothing_is_waited_for_where_spi_hangs() -> None:
    bus = BoardBus()
    confirmed, said = told(bus, stops_written=False)
    assert confirmed
    assert bus.board.fed == 0
    ((sentence, is_confirmed),) = said
    assert is_confirmed
    took = re.search(r"after (\d+) ms", sentence)
    assert took is not None
    assert int(took[1]) < 10_000


@pytest.mark.parametrize(
    ("failure", "why"),
    [
        (ConfigError("python-can is not installed"), "python-can is not installed"),
        (LineError("can0 is gone"), "can0 is gone"),
        (RuntimeError("a mistake of its own"), "socketcan can0: a mistake of its own"),
    ],
)
def test_why_it_is_not_confirmed(monkeypatch: pytest.MonkeyPatch, failure: Exception, why: str) -> None:
    monkeypatch.setattr(last_cut, "TRY_NS", NS_PER_MS)
    bus = BoardBus()
    bus.failures = [failure] * 100  # it is opened again as long as there is time
    assert told(bus) == (False, [(last_cut.not_confirmed(why), False)])


def test_on_a_computer_that_loads_python_can_for_long_the_mask_is_sent_all_the_same(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The emulated machine of `make kernel` takes 4 s for it, and an SD card that was not read yet may."""
    bus, loaded = BoardBus(), 0

    def slow(settings: PowerSettings) -> BoardBus:
        nonlocal loaded
        loaded = 10 * last_cut.TRY_NS
        return bus.opened(settings)

    clock = SimpleNamespace(monotonic_ns=lambda: time.monotonic_ns() + loaded, sleep=time.sleep)
    monkeypatch.setattr(last_cut, "time", clock)

    cut = SupplyCut(SETTINGS, lambda *_: None, slow)
    assert cut.end()
    assert bus.board.fed == 0


def test_nobody_waits_for_what_hangs(monkeypatch: pytest.MonkeyPatch) -> None:
    """In python-can, or in the kernel."""
    monkeypatch.setattr(last_cut, "TRY_NS", NS_PER_MS)
    monkeypatch.setattr(last_cut, "END_S", 0.01)
    bus = BoardBus()
    bus.hangs.clear()
    confirmed, said = told(bus)
    hanging = [thread for thread in threading.enumerate() if thread.name == "supply cut"]
    assert hanging
    assert all(thread.daemon for thread in hanging), "the process ends all the same"
    bus.hangs.set()
    assert not confirmed
    ((sentence, is_confirmed),) = said
    assert "hangs" in sentence
    assert not is_confirmed


def test_on_an_adapter_that_a_gateway_goes_on_using(tmp_path: Path) -> None:
    """By slcan on a terminal. Its channel stays open: the gateway would not notice that it was closed."""
    adapter = Adapter(str(tmp_path / "can"))
    adapter.board.take(set_supply(ALL), time.monotonic_ns())
    said: list[str] = []
    cut = SupplyCut(PowerSettings("slcan", str(tmp_path / "can")), lambda sentence, _: said.append(sentence))
    confirmed = cut.end()
    gc.collect()
    adapter.unplug()
    assert confirmed, said
    assert adapter.board.fed == 0
    assert b"C" not in adapter.received[adapter.received.index(b"O") :]


def test_it_begins_behind_the_first_stops_or_at_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(last_cut, "START_S", 60.0)
    bus = BoardBus()
    cut = SupplyCut(SETTINGS, lambda *_: None, bus.opened)
    assert not bus.first_sent.wait(0.05)
    cut.stops_written()
    assert bus.first_sent.wait(10)
    assert cut.end()
    assert SupplyCut(SETTINGS, lambda *_: None, BoardBus().opened).end(), "to wait for its end has it begin"
