"""The last attempt to stop the robot: each leg is tried, whatever another one's Stop met."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from gateway.errors import SpiError
from gateway.host.settings_table import ControllerSettings, SpiSettings, WireSettings
from gateway.model.elkapod import SHUTDOWN
from gateway.model.frames import PREAMBLE_ZEROS, ZERO, Framing, stop_leg
from gateway.model.protocols import SpiProtocol
from gateway.robot.host import stop_note
from gateway.robot.spi import Batch, SpiDevice, stop_all
from gateway.robot.spi.bus import Bus
from gateway.robot.spi.stop_all import stop_before_service, stop_once, stop_servos
from gateway.robot.spi.uart import Uart
from schemas.robot import LEGS

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
    assert stop_note.take() == (first_ns, 1 + pauses)


@pytest.mark.parametrize("failing", [[3], LEGS])
def test_stop_servos_ends_with_the_fault_if_a_leg_got_no_stop(failing: Iterable[int], stops: Stops) -> None:
    scene = Rounds(failing, 1000)
    with pytest.raises(SpiError, match="told to fail"):
        stops(scene)
    assert scene.sleeps_ms == [20] * 13
    assert scene.log[-2:] == ["closed", "ended"]
    assert stop_note.take() == ()


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
