"""The last attempt to stop the robot: each leg is tried, and the supply is cut."""

import gc
import re
import threading
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace

import can
import pytest

from gateway.errors import SpiError
from gateway.host.settings_table import ControllerSettings, PowerSettings, SpiSettings, WireSettings
from gateway.model.elkapod import SHUTDOWN
from gateway.model.frames import PREAMBLE_ZEROS, ZERO, Framing, stop_leg
from gateway.model.power_board import ALL, set_supply
from gateway.model.protocols import SpiProtocol
from gateway.rate_limit import NS_PER_MS
from gateway.robot.power import last_cut
from gateway.robot.power.interface import LineError
from gateway.robot.power.last_cut import SupplyCut
from gateway.robot.spi import Batch, SpiDevice, stop_all
from gateway.robot.spi.bus import Bus
from gateway.robot.spi.stop_all import stop_before_service, stop_once, stop_servos, take_note
from gateway.robot.spi.uart import Uart
from schemas.robot import LEGS
from tests.support.boards import Adapter, BoardBus

SETTINGS = PowerSettings("socketcan")


def told(bus: BoardBus, *, stops_written: bool = True) -> tuple[bool, list[tuple[str, bool]]]:
    """Return what it reports, once it returns."""
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


def test_a_cut_leaves_the_channel_of_an_adapter_open_that_a_gateway_uses(tmp_path: Path) -> None:
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


def test_the_last_cut_begins_after_the_first_stops_or_at_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(last_cut, "START_S", 60.0)
    bus = BoardBus()
    cut = SupplyCut(SETTINGS, lambda *_: None, bus.opened)
    assert not bus.first_sent.wait(0.05)
    cut.stops_written.set()
    assert bus.first_sent.wait(10)
    assert cut.end()
    assert SupplyCut(SETTINGS, lambda *_: None, BoardBus().opened).end(), "to wait for its end has it begin"


MISTAKES = [SpiError("told to fail"), SystemError("returned NULL"), TypeError("a mistake of our own"), KeyError(3)]


class Device(SpiDevice):
    """Fails the transfers that carry one leg's Stop (and with it its whole batch), or each opening."""

    def __init__(self, mistake: Exception, leg: int | None) -> None:
        self._mistake = mistake
        self._failing = None if leg is None else stop_leg(leg).data
        self.recovers = False
        """Whether its second opening ends the fault."""
        self.openings = 0
        self.seen: list[bytes] = []

    def open(self) -> "Device":
        self.openings += 1
        if self._failing is None:
            raise self._mistake
        return self

    def transfer(self, batch: Batch) -> None:
        for data, _ in batch:
            if data == self._failing and not (self.recovers and self.openings > 1):
                raise self._mistake
            self.seen.append(data)


@pytest.mark.parametrize("mistake", MISTAKES, ids=repr)
@pytest.mark.parametrize("leg", LEGS)
def test_whatever_one_legs_stop_meets_the_others_get_theirs(mistake: Exception, leg: int) -> None:
    device = Device(mistake, leg)
    bus = Bus(SpiSettings(speed_hz=2_500_000), device.open)
    bus.open()
    for _ in range(2):  # again and again
        device.seen.clear()
        stopped, fault = stop_once(bus, opened=True)
        assert stopped == set(LEGS) - {leg}
        assert fault is mistake
        expected = [stop_leg(other).data for other in LEGS if other != leg]
        assert sorted(set(device.seen)) == expected


@pytest.mark.parametrize("mistake", MISTAKES, ids=repr)
def test_each_leg_tries_to_open_a_device_that_does_not_answer(mistake: Exception) -> None:
    device = Device(mistake, None)
    assert stop_once(Bus(SpiSettings(speed_hz=2_500_000), device.open)) == (set(), mistake)
    assert device.openings == 1 + len(LEGS)


def test_a_device_at_fault_is_opened_again_for_the_leg_that_got_no_stop() -> None:
    device = Device(SpiError("told to fail"), LEGS[-1])
    device.recovers = True
    stopped, fault = stop_once(Bus(SpiSettings(speed_hz=2_500_000), device.open))
    assert (stopped, str(fault), device.openings) == (set(LEGS), "told to fail", 2)


def test_a_repetition_resynchronises_the_controller_first() -> None:
    device = Device(KeyError(), None)
    bus = Bus(SpiSettings(speed_hz=2_500_000, framing=Framing.LENGTH_PREFIXED), lambda: device)
    bus.open()
    for _ in range(2):
        device.seen.clear()
        stop_once(bus, opened=True)
        assert device.seen[:PREAMBLE_ZEROS] == [ZERO] * PREAMBLE_ZEROS
        assert device.seen[PREAMBLE_ZEROS + 1] == stop_leg(LEGS[0]).data


# ---- stop-servos: in rounds


@dataclass
class Rounds(SpiDevice, Uart):
    """What `stop-servos` uses: a device (or UART) whose Stops for these legs fail in the first rounds, the notice to a
    gateway, and a clock."""

    failing: Iterable[int] = ()
    failing_rounds: int = 0
    gateway_runs: bool = False
    log: list[str] = field(default_factory=list)
    sleeps_ms: list[float] = field(default_factory=list)

    def transfer(self, batch: Batch) -> None:
        for data, _ in batch:
            self.write(data)

    def write(self, data: bytes) -> None:
        failing = {SHUTDOWN, *(stop_leg(leg).data for leg in self.failing)}
        if len(self.sleeps_ms) < self.failing_rounds and data in failing:
            raise SpiError("told to fail")
        self.log.append("stop")

    def read(self) -> bytes:
        return b""

    def close(self) -> None:
        self.log.append("closed")

    def monotonic_ns(self) -> int:
        return len(self.sleeps_ms) + 1

    def sleep(self, pause_s: float) -> None:
        self.sleeps_ms.append(pause_s * 1000)

    def give(self) -> None:
        self.log.append("given")

    def end(self) -> bool:
        self.log.append("ended")
        return True


Stops = Callable[..., bool | None]


@pytest.fixture
def stops(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Stops:
    monkeypatch.setenv("RUNTIME_DIRECTORY", str(tmp_path))

    def run(rounds: Rounds, protocol: str = SpiProtocol.HEXAPOD_1_0, *, exclusive: bool = False) -> bool | None:
        def opens(*asked: object, **options: bool) -> Rounds:
            assert asked in {("/dev/spidev0.0", 2_500_000), ("/dev/ttyAMA1",)}
            assert options == {"exclusive": exclusive}, "whether it is opened for nobody else, as by a gateway"
            return rounds

        def notice(path: str) -> Rounds:
            assert path == "/dev/spidev0.0"
            return rounds

        for name, instead in {"KernelDevice": opens, "SerialUart": opens, "Notice": notice, "time": rounds}.items():
            monkeypatch.setattr(stop_all, name, instead)
        settings = WireSettings(protocol), SpiSettings(speed_hz=2_500_000), ControllerSettings()
        if exclusive:
            stop_before_service(*settings)
            return None
        return stop_servos(*settings, lambda: rounds.log.append("written"))

    return run


@pytest.mark.parametrize(
    ("failing", "rounds", "pauses", "first_ns"),
    [
        ([], 0, 3, 1),
        (LEGS, 1, 3, 2),
        ([3], 4, 4, 1),  # one leg in all repeats
        (LEGS, 13, 13, 14),  # but for the last
    ],
)
def test_stop_servos_repeats_its_stops_and_goes_on_while_a_leg_got_none(
    failing: Iterable[int], rounds: int, pauses: int, first_ns: int, stops: Stops
) -> None:
    scene = Rounds(failing, rounds)
    assert stops(scene) is None, "no gateway runs"
    assert scene.sleeps_ms == [20] * pauses
    assert scene.log[-2:] == ["closed", "ended"]
    assert scene.log.count("given") == 1 + pauses
    assert take_note() == (first_ns, 1 + pauses)


@pytest.mark.parametrize("failing", [[3], LEGS])
def test_stop_servos_ends_with_the_fault_if_a_leg_got_no_stop(failing: Iterable[int], stops: Stops) -> None:
    scene = Rounds(failing, 1000)
    with pytest.raises(SpiError, match="told to fail"):
        stops(scene)
    assert scene.sleeps_ms == [20] * 13
    assert scene.log[-2:] == ["closed", "ended"]
    assert take_note() == ()


def test_the_supply_is_taken_and_the_notice_given_after_the_first_stops(stops: Stops) -> None:
    scene = Rounds(gateway_runs=True)
    assert stops(scene) is True, "the gateway has noticed"
    assert [line for line in scene.log if line != "closed"] == [*[*["stop"] * 6, "written", "given"] * 4, "ended"]


@pytest.mark.parametrize("failing_rounds", [0, 2])
def test_elkapod_2025_is_shut_down_over_a_uart_that_a_gateway_may_hold(failing_rounds: int, stops: Stops) -> None:
    scene = Rounds(LEGS, failing_rounds)
    assert stops(scene, SpiProtocol.ELKAPOD_2025) is None
    assert scene.log.count("stop") == 2 * (4 - failing_rounds), "opening it is one, too"
    assert scene.sleeps_ms == [20] * 3
    assert scene.log[-2:] == ["closed", "ended"]


@pytest.mark.parametrize(("protocol", "stops_written"), [(SpiProtocol.HEXAPOD_1_0, 6), (SpiProtocol.ELKAPOD_2025, 2)])
def test_a_gateways_first_stops_are_one_round_on_a_device_of_its_own(
    protocol: SpiProtocol, stops_written: int, stops: Stops
) -> None:
    scene = Rounds()
    stops(scene, protocol, exclusive=True)
    assert scene.log == ["stop"] * stops_written + ["closed"]
