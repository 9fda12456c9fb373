"""`stop-servos` takes the supply: what is confirmed, and that nothing on SPI is waited for."""

import gc
import re
import threading
import time
from pathlib import Path
from types import SimpleNamespace

import can
import pytest

from gateway.host.settings_table import PowerSettings
from gateway.model.power_board import ALL, set_supply
from gateway.rate_limit import NS_PER_MS
from gateway.robot.power import last_cut
from gateway.robot.power.interface import LineError
from gateway.robot.power.last_cut import SupplyCut
from tests.support.board_bus import BoardBus
from tests.support.slcan_adapter import Adapter

SETTINGS = PowerSettings("socketcan")


def told(bus: BoardBus, *, stops_written: bool = True) -> tuple[bool, list[tuple[str, bool]]]:
    """What it says, and returns."""
    said: list[tuple[str, bool]] = []
    cut = SupplyCut(SETTINGS, lambda sentence, confirmed: said.append((sentence, confirmed)), bus.opened)
    if stops_written:
        cut.stops_written.set()
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


def test_a_flood_of_frames_that_are_no_answers_keeps_no_mask_from_the_board(monkeypatch: pytest.MonkeyPatch) -> None:
    """The kernel's error frames of a disturbed bus, or another node with identifiers of 29 bits."""
    flood = can.Message(arbitration_id=1, is_extended_id=True)

    class Flooded(BoardBus):
        def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:  # noqa: ARG002
            found, filtered = super()._recv_internal(0)
            return found or flood, filtered

    monkeypatch.setattr(last_cut, "END_S", 3.0)
    bus = Flooded()
    confirmed, _ = told(bus)
    assert confirmed
    assert bus.board.fed == 0


def test_why_it_is_not_confirmed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(last_cut, "TRY_NS", NS_PER_MS)
    bus = BoardBus()
    bus.failures = [LineError("can0 is gone")] * 100  # it is opened again as long as there is time
    assert told(bus) == (False, [(last_cut.NOT_CONFIRMED.format("can0 is gone"), False)])


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
    cut.stops_written.set()
    assert bus.first_sent.wait(10)
    assert cut.end()
    assert SupplyCut(SETTINGS, lambda *_: None, BoardBus().opened).end(), "to wait for its end has it begin"
