"""With which settings `stop-servos` writes: those that the controller has understood, whatever a file says by now."""

from pathlib import Path

import pytest

from gateway.errors import ConfigError
from gateway.host import effective
from gateway.host.plain_settings import ControllerValues, PlainController, PlainRepeats, RepeatValues, SpiValues
from gateway.model.framing import Framing
from gateway.onboard import stop
from gateway.robot import settings as settings_file

PLAIN = 'spi.framing = "plain"\n'
ANOTHER = f'{PLAIN}spi.device = "/dev/spidev1.0"\n'
PREFIXED, NONE = Framing.LENGTH_PREFIXED, None
RUNS, ENDED_HERE, ENDED, NEVER = "runs", "ended here", "ended", "never"


class Robot:
    """The service's folder and file, and how a service ended."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.file = folder / "gateway.toml"
        self.used: list[SpiValues] = []
        self.unit: tuple[int, dict[str, str]] = (0, {})
        self._folder = folder
        self._patch = monkeypatch
        monkeypatch.setenv("RUNTIME_DIRECTORY", str(folder))
        monkeypatch.setenv("HEXAPOD_SPI__FRAMING", "")  # and so as before after the test
        monkeypatch.delenv("HEXAPOD_SPI__FRAMING")
        monkeypatch.setattr(stop, "DEFAULT_PATH", self.file)
        monkeypatch.setattr(settings_file, "DEFAULT_PATH", self.file)
        monkeypatch.setattr(stop, "unit", lambda: self.unit)
        monkeypatch.setattr(stop, "stop", self._stop)

    def _stop(self, spi: SpiValues, _watchdog: RepeatValues, _controller: ControllerValues) -> None:
        self.used.append(spi)

    def service(self, state: str) -> None:
        """It was started with length-prefixed by a variable, and this is what became of it."""
        if state == NEVER:
            return
        self._patch.setenv("INVOCATION_ID", "1")
        effective.write({"framing": "length-prefixed"}, PlainRepeats(), PlainController())
        if state != ENDED_HERE:
            self._patch.delenv("INVOCATION_ID")
        if state in {ENDED, ENDED_HERE}:
            path = self._folder / effective.NAME
            path.write_text(path.read_text().replace("begun = ", "begun = 1"))


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
def test_the_settings_that_are_used(
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


def test_a_person_is_shown_where_the_file_differs(robot: Robot, capsys: pytest.CaptureFixture[str]) -> None:
    """After the Stops; not in the journal after each end, where the file lacks the unit's variables by design."""
    robot.file.write_text(PLAIN)
    robot.service(RUNS)
    stop.run(None)
    shown = f'{robot.file} has spi.framing = "plain", and the service uses "length-prefixed"; used the latter\n'
    assert capsys.readouterr().err == f"hexapod-gateway: {shown}"
    robot.service(ENDED_HERE)
    stop.run(robot.file)
    assert capsys.readouterr().err == ""


def test_before_the_first_start_the_units_variables_count(robot: Robot) -> None:
    robot.file.write_text(PLAIN)
    robot.unit = 0, {"HEXAPOD_SPI__FRAMING": "length-prefixed"}
    stop.run(None)
    assert [spi.framing for spi in robot.used] == [PREFIXED]


def test_another_process_has_spoken_to_the_controller_since(robot: Robot) -> None:
    """An older release, after a rollback: what is left of a newer one is stale."""
    robot.file.write_text(PLAIN)
    robot.service(ENDED)
    robot.unit = 123, {}
    stop.run(None)
    assert [spi.framing for spi in robot.used] == [Framing.PLAIN]


def test_a_variable_that_names_another_device_is_meant(robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    robot.file.write_text(PLAIN)
    robot.service(RUNS)
    monkeypatch.setenv("HEXAPOD_SPI__DEVICE", "/dev/spidev1.0")
    stop.run(None)
    assert [(spi.device, spi.framing) for spi in robot.used] == [("/dev/spidev1.0", Framing.PLAIN)]
