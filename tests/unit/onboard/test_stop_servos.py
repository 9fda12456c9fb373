"""`stop-servos` writes with the settings that the controller understands, whatever a file has by now."""

from collections.abc import Callable
from pathlib import Path

import pytest

from gateway.errors import ConfigError, SpiError
from gateway.host import effective, realtime
from gateway.host.settings_reader import ForStops
from gateway.host.settings_table import ControllerSettings, PowerSettings, SpiSettings, WireSettings
from gateway.model.frames import Framing
from gateway.onboard import stop
from gateway.robot import settings as settings_file
from gateway.robot.power import last_cut
from gateway.robot.power.last_cut import SupplyCut
from gateway.robot.spi import outside
from tests.support.boards import BoardBus

PLAIN = 'spi.framing = "plain"\n'
ANOTHER = f'{PLAIN}spi.device = "/dev/spidev1.0"\n'
PREFIXED, NONE = Framing.LENGTH_PREFIXED, None
RUNS, ENDED_HERE, ENDED, NEVER = "runs", "ended here", "ended", "never"


class Robot:
    """The service's folder and file, and how a service ended."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.file = folder / "gateway.toml"
        self.used: list[SpiSettings] = []
        self.spi_fails = False
        self.power = PowerSettings()
        self.device = SpiSettings().device
        self.unit: tuple[int, dict[str, str]] = (0, {})
        self._folder = folder
        self._patch = monkeypatch
        monkeypatch.setenv("RUNTIME_DIRECTORY", str(folder))
        monkeypatch.setenv("HEXAPOD_SPI__FRAMING", "")  # and so as before after the test
        monkeypatch.delenv("HEXAPOD_SPI__FRAMING")
        monkeypatch.setattr(stop, "CONFIGURATION", self.file)
        monkeypatch.setattr(settings_file, "CONFIGURATION", self.file)
        monkeypatch.setattr(stop, "unit", lambda: self.unit)
        monkeypatch.setattr(stop, "stop", self._stop)

    def _stop(
        self, _wire: WireSettings, spi: SpiSettings, _controller: ControllerSettings, written: Callable[[], None]
    ) -> None:
        self.used.append(spi)
        if self.spi_fails:
            raise SpiError("no such device")
        written()

    def service(self, state: str) -> None:
        """Start the service with length-prefixed by a variable, in this state."""
        if state == NEVER:
            return
        self._patch.setenv("INVOCATION_ID", "1")
        spi = SpiSettings(device=self.device, framing=PREFIXED).of(WireSettings())
        effective.write(ForStops(WireSettings(), spi, ControllerSettings(), self.power))
        if state != ENDED_HERE:
            self._patch.delenv("INVOCATION_ID")
        if state in {ENDED, ENDED_HERE}:
            path = self._folder / effective.NAME
            path.write_text(path.read_text().replace('"begun": ', '"begun": 1'))


@pytest.fixture
def robot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Robot:
    return Robot(tmp_path, monkeypatch)


CASES = [
    # the service, its file, whether that is named by --config, the framing that is used
    (RUNS, PLAIN, False, PREFIXED),
    (RUNS, PLAIN, True, PREFIXED),
    (RUNS, ANOTHER, False, PREFIXED),
    (RUNS, ANOTHER, True, Framing.PLAIN),
    (RUNS, "", False, PREFIXED),
    (RUNS, "damaged", True, PREFIXED),
    (RUNS, None, False, PREFIXED),
    (RUNS, None, True, PREFIXED),
    (ENDED_HERE, PLAIN, True, PREFIXED),
    (ENDED_HERE, "damaged", True, PREFIXED),
    (ENDED_HERE, None, True, PREFIXED),
    (ENDED, PLAIN, False, PREFIXED),
    (ENDED, PLAIN, True, Framing.PLAIN),
    (ENDED, "damaged", True, PREFIXED),
    (ENDED, None, True, PREFIXED),
    (ENDED, "", True, PREFIXED),
    (NEVER, PLAIN, False, Framing.PLAIN),
    (NEVER, PLAIN, True, Framing.PLAIN),
    (NEVER, "", False, NONE),
    (NEVER, None, True, NONE),
    (NEVER, "damaged", False, NONE),
]


@pytest.mark.parametrize(("state", "text", "named", "expected"), CASES)
def test_stop_servos_uses_the_settings_that_the_controller_understands(
    robot: Robot, state: str, text: str | None, named: bool, expected: Framing | None
) -> None:
    """It stops wherever anything says how; only where nothing does, it writes nothing that could jam a controller."""
    if text is not None:
        robot.file.write_text(text)
    robot.service(state)
    path = robot.file if named else None
    if expected is None:
        with pytest.raises(ConfigError):
            stop.run(path)
        assert robot.used == []
    else:
        stop.run(path)
        assert [spi.framing for spi in robot.used] == [expected]


@pytest.mark.parametrize(
    ("state", "status", "held", "stops"),
    [
        (ENDED_HERE, "6", True, False),
        (ENDED_HERE, "6", False, True),
        (ENDED_HERE, "6", None, True),
        (ENDED_HERE, "3", True, True),
        (ENDED_HERE, "KILL", True, True),
        (ENDED_HERE, "", True, True),
        (ENDED, "6", True, True),
        (RUNS, "6", True, True),
    ],
)
def test_only_another_gateways_robot_is_not_stopped_by_the_end_of_a_service_that_never_had_it(
    robot: Robot, monkeypatch: pytest.MonkeyPatch, state: str, status: str, held: bool | None, stops: bool
) -> None:
    """It stops in each doubt: about the device's holder, about what the service did, and if systemd did not ask."""
    robot.file.write_text(PLAIN)
    robot.device = str(robot.file)  # which can be opened
    robot.service(state)
    monkeypatch.setenv("EXIT_STATUS", status)
    monkeypatch.setattr(outside, "is_locked", lambda *_: held)
    stop.run(None)
    assert len(robot.used) == stops


def test_a_variable_that_names_another_device_has_precedence(robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    robot.file.write_text(PLAIN)
    robot.service(RUNS)
    monkeypatch.setenv("HEXAPOD_SPI__DEVICE", "/dev/spidev1.0")
    stop.run(None)
    assert [(spi.device, spi.framing) for spi in robot.used] == [("/dev/spidev1.0", Framing.PLAIN)]


# ---- the supply


BOARD = '[power]\ninterface = "socketcan"\n'
CONFIRMED = "the power board has confirmed: all servos without supply, after "
BY_HAND = "switch the power off by hand"


@pytest.fixture
def bus(monkeypatch: pytest.MonkeyPatch) -> BoardBus:
    """Return the bus of the power board that `stop-servos` finds, on whatever interface its settings name."""
    found = BoardBus()
    monkeypatch.setattr(last_cut, "SupplyCut", lambda settings, say: SupplyCut(settings, say, found.opened))
    return found


def test_stops_are_written_although_the_boards_settings_are_wrong(
    robot: Robot, capsys: pytest.CaptureFixture[str]
) -> None:
    robot.file.write_text(PLAIN + "[power]\ninterface = 3\n")
    assert not stop.run(robot.file)
    assert len(robot.used) == 1
    assert BY_HAND in capsys.readouterr().err


def test_stops_precede_the_report_of_wrong_settings_of_the_board(robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    def nobody_reads(*_: str) -> None:
        assert len(robot.used) == 1
        raise BrokenPipeError

    robot.file.write_text(PLAIN + "[power]\ninterface = 3\n")
    monkeypatch.setattr(stop, "_say", nobody_reads)
    with pytest.raises(BrokenPipeError):
        stop.run(robot.file)
    assert len(robot.used) == 1


def test_the_supply_is_cut_although_spi_fails(robot: Robot, bus: BoardBus, capsys: pytest.CaptureFixture[str]) -> None:
    robot.file.write_text(PLAIN + BOARD)
    robot.spi_fails = True
    with pytest.raises(SpiError):
        stop.run(robot.file)
    assert bus.board.fed == 0
    assert CONFIRMED in capsys.readouterr().out


def test_a_cut_without_confirmation_has_its_own_exit_code(
    robot: Robot, bus: BoardBus, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    robot.file.write_text(PLAIN + BOARD)
    bus.silent = True
    monkeypatch.setattr(last_cut, "TRY_NS", 1)
    monkeypatch.setattr(realtime, "prefer_process", lambda: None)
    monkeypatch.setattr(realtime, "prefer_thread", lambda _: True)
    assert stop.at_once(["--config", str(robot.file)]) == stop.NOT_CONFIRMED
    assert len(robot.used) == 1
    assert BY_HAND in capsys.readouterr().err
