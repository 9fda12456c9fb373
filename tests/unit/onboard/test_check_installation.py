"""`check`: an installation below a folder, a UART and a power board; and what `--move` says of the board's currents."""

import datetime as dt
import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from gateway import certs
from gateway.onboard import whole
from gateway.onboard.check import wire
from gateway.onboard.check.installation import AS_ROOT, unit
from gateway.onboard.check.move import output
from gateway.onboard.check.table import CheckedRobot, Result, Verdict, results
from gateway.onboard.whole import Whole
from gateway.robot.settings import Settings
from schemas.telemetry import ServoTelemetry, Telemetry
from tests.support.machine_tree import MachineTree
from tests.support.slcan_adapter import Adapter

UP = {"LoadState": "loaded", "ActiveState": "active", "UnitFileState": "enabled", "NeedDaemonReload": "no"}
UP |= {"ExecStopPost": "{ path=/run/program ; argv[]=/run/program stop-servos }"}
DROP_IN = "/etc/systemd/system/hexapod-gateway.service.d/own.conf"
STATE = "var/lib/hexapod-gateway"
LIBRARY = "usr/lib/hexapod-gateway"
OTHER_UNIT = "etc/systemd/system/hexapod-gateway.service"
UNIT_FILE = "usr/lib/systemd/system/hexapod-gateway.service"


class Installed(CheckedRobot):
    """A package in a folder, with what systemd would show of its unit. Its user is the one that runs this."""

    def __init__(self, root: Path) -> None:
        super().__init__(root=root)
        self.write("run/program", "#!/run/program", 0o755)
        for place in (f"{LIBRARY}/1.1.0/units/hexapod-gateway.service", UNIT_FILE):
            self.write(place, "[Service]", 0o644)
        (root / LIBRARY / "current").symlink_to("1.1.0")
        for folder in (STATE, "run/systemd/system"):
            (root / folder).mkdir(parents=True)
        self.service = os.getuid(), os.getgid()
        self.version, self.files = "1.1.0", Whole()
        self.unit: dict[str, str] = dict(UP)

    def drop_in(self, text: str) -> None:
        path = self.path(DROP_IN)
        path.parent.mkdir(parents=True)
        path.write_text(f"[Service]\n{text}\n")
        self.unit["DropInPaths"] = DROP_IN

    def show(self, **properties: str) -> None:
        self.unit.update(properties)

    def write(self, name: str, text: str = "", mode: int = 0o600) -> None:
        path = self.root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
        path.chmod(mode)

    def keys(self, name: str) -> None:
        certs.folder.init(self.root / "C", ["127.0.0.1"])
        for source, target in (("ca.key", name), ("ca.pem", "ca.pem")):
            self.write(f"etc/hexapod-gateway/zenoh/{target}", (self.root / "C" / source).read_text(), 0o640)

    def file_for_folder(self) -> None:
        (self.root / STATE).rmdir()
        self.write(STATE)

    def mask(self) -> None:
        (self.root / "run/systemd/system/hexapod-gateway.service").symlink_to("/dev/null")
        self.show(LoadState="masked")

    def runs(self, variables: str, maps: str = "") -> None:
        self.write("proc/7/environ", variables)
        self.write("proc/7/maps", maps)
        self.show(MainPID="7")

    def forget_python(self) -> None:
        self.write("x", "#!/usr/bin/python3.1 -I\n", 0o755)
        self.show(ExecStart="{ path=/x ; argv[]=/x }")

    def forget(self, name: str) -> None:
        (self.root / name).unlink()


Plant = Callable[[Installed], object]
PLANTED: tuple[tuple[Plant, str], ...] = (
    (lambda robot: setattr(robot, "files", Whole(changed=("/usr/a", "/usr/b"))), "not as installed: /usr/a, /usr/b"),
    (lambda robot: setattr(robot, "files", Whole(added=("/usr/a",))), "and not installed with it: /usr/a"),
    (lambda robot: setattr(robot, "files", Whole(closed=("/usr/a",))), "not readable by all"),
    (lambda robot: setattr(robot, "version", "1.2.0"), "1.2.0 is installed, but 1.1.0 runs until no servo runs"),
    (
        lambda robot: robot.runs("", "7f-8a r-xp /usr/lib/hexapod-gateway/1.0.9.kept/x.so"),
        "the running service is 1.0",
    ),
    (lambda robot: robot.forget(UNIT_FILE), f"/{UNIT_FILE} is not this release's"),
    (lambda robot: robot.write(UNIT_FILE, "x"), f"/{UNIT_FILE} is not this release's"),
    (lambda robot: robot.write(OTHER_UNIT, "[Service]"), f"/{OTHER_UNIT} is not this release's"),
    (lambda robot: robot.show(ExecStart="{ path=/none ; argv[]=/none }"), "/none cannot be run"),
    (lambda robot: robot.forget_python(), "/usr/bin/python3.1 cannot be run"),
    (lambda robot: robot.show(ExecStopPost="{ path=/run/program ; }"), "runs no stop-servos after its end"),
    (lambda robot: robot.mask(), "/run/systemd/system/hexapod-gateway.service is not"),
    (lambda robot: robot.show(NeedDaemonReload="yes"), "hexapod-gateway was edited, but systemd still"),
    (lambda robot: robot.drop_in("Environment=GATEWAY_OPTIONS=--sim\nExecStopPost="), "makes the controller a simu"),
    (lambda robot: robot.drop_in("ExecStopPost="), "what Stops depend on: ExecStopPost"),
    (lambda robot: robot.drop_in("Environment=HEXAPOD_SPI__FRAMING=plain"), "depend on: HEXAPOD_SPI__FRAMING"),
    (lambda robot: robot.drop_in("User=root\nNice=3"), "Stops depend on: Nice, User"),
    (lambda robot: robot.drop_in("Environment=A=1 PYTHONPATH=/x\nMemoryMax=64M"), "depend on: MemoryMax, PYTHONPATH"),
    (lambda robot: robot.drop_in("ExecStopPost=\nExecStopPost=/opt/x \\\n  stop-servos"), "depend on: ExecStopPost"),
    (lambda robot: robot.runs("A=1\0HEXAPOD_SPI__FRAMING=plain\0"), "HEXAPOD_SPI__FRAMING is in the service's env"),
    (lambda robot: robot.runs("PYTHONPATH=/x\0"), "PYTHONPATH is in the service's environment"),
    (lambda robot: robot.file_for_folder(), "is no folder"),
    (lambda robot: robot.path(STATE).chmod(0o500), f"may not read and write /{STATE}"),
    (lambda robot: robot.write(f"{STATE}/a", mode=0o400), f"may not read and write /{STATE}/a"),
    (lambda robot: robot.write("etc/hexapod-gateway/a.key", mode=0o604), "not only root and the service may read"),
    (lambda robot: robot.keys("old.key"), "zenoh/old.key is the authority's key"),
    (lambda robot: robot.keys("ca.key"), "zenoh/ca.key is the authority's key"),
)
FINE: tuple[Plant, ...] = (
    lambda _: None,
    lambda robot: robot.drop_in("# ExecStopPost=\n;User=root\nCPUWeight=9"),
    lambda robot: robot.drop_in("Environment=LANG=C"),
)


def found(robot: Installed) -> list[Result]:
    """Without what is so of this machine: a folder that a boot empties."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(whole, "compare", lambda: robot.files)
        patch.setattr(whole, "version", lambda: robot.version)
        lines = [each for each in results(robot, *AS_ROOT, unit) if each.verdict is not Verdict.OK]
    lines = [each for each in lines if each.name != "user"]
    return [each for each in lines if "which a boot empties" not in each.sentence]


@pytest.mark.parametrize(("plant", "sentence"), PLANTED, ids=[sentence for _, sentence in PLANTED])
def test_each_fault_of_an_installation_is_one_line(plant: Plant, sentence: str, tmp_path: Path) -> None:
    robot = Installed(tmp_path)
    plant(robot)
    (line,) = found(robot)
    assert sentence in line.sentence
    assert line.verdict is not Verdict.OK
    assert "sudo " in line.fix or "systemctl cat" in line.fix


@pytest.mark.parametrize("plant", FINE)
def test_what_is_well_is_no_line(plant: Plant, tmp_path: Path) -> None:
    robot = Installed(tmp_path)
    plant(robot)
    assert found(robot) == []


BYTES = b"\x7e\xaa\n"


# ---- the UART of elkapod-2025


class Terminal:
    """A pseudo terminal in place of a UART, on which something has been sent, and the /proc and /sys of its machine."""

    def __init__(self, root: Path) -> None:
        self.ours, self._theirs = os.openpty()
        os.write(self.ours, BYTES)
        self.path = os.ttyname(self._theirs)
        settings = Settings.of({"wire": {"name": "elkapod-2025"}, "controller": {"uart": self.path}})
        self.units: dict[str, dict[str, str]] = {}
        self.robot = CheckedRobot(settings, root, lambda unit: self.units.get(unit, {}))
        MachineTree(root)

    def console(self, names: str) -> None:
        folder = self.robot.root / "sys/class/tty/console"
        folder.mkdir(parents=True)
        (folder / "active").write_text(f"{names}\n")

    def login(self) -> None:
        self.units[f"serial-getty@{Path(self.path).name}.service"] = {"ActiveState": "active"}

    def unread(self) -> bytes:
        reader = os.open(self.path, os.O_RDONLY | os.O_NONBLOCK)
        try:
            return os.read(reader, 16)
        finally:
            os.close(reader)

    def close(self) -> None:
        os.close(self.ours)
        os.close(self._theirs)


@pytest.fixture
def terminal(tmp_path: Path) -> Iterator[Terminal]:
    made = Terminal(tmp_path)
    yield made
    made.close()


@pytest.mark.parametrize(
    ("plant", "verdict", "says"),
    [
        (lambda _: None, "ok", " opens"),
        (lambda each: each.console("tty1"), "ok", " opens"),
        (lambda each: setattr(each.robot, "gateway_runs", True), "ok", "is the running gateway's"),
        (lambda each: each.console(f"tty1 {Path(each.path).name}"), "failure", "console or a login"),
        (Terminal.login, "failure", "console or a login"),
    ],
)
def test_a_uart(terminal: Terminal, plant: Callable[[Terminal], None], verdict: str, says: str) -> None:
    """What a gateway will read, or nobody may, is left there."""
    plant(terminal)
    (found,) = results(terminal.robot, wire.uart)
    assert (found.verdict, says in found.sentence) == (verdict, True), found
    if verdict != "ok" or terminal.robot.gateway_runs:
        assert terminal.unread() == BYTES


# ---- the power board


@pytest.fixture
def adapter(tmp_path: Path) -> Iterator[Adapter]:
    made = Adapter(str(tmp_path / "adapter"))
    yield made
    made.unplug()


def board(tmp_path: Path, *, gateway_runs: bool = False) -> Result:
    settings = Settings.of({"power": {"interface": "slcan", "channel": str(tmp_path / "adapter")}})
    (found,) = results(CheckedRobot(settings, gateway_runs=gateway_runs), wire.power)
    return found


def test_a_board_that_is_the_gateways_or_not_for_this_user_is_not_opened(
    adapter: Adapter, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert board(tmp_path, gateway_runs=True).verdict == "ok"
    with monkeypatch.context() as patch:
        patch.setitem(sys.modules, "can", None)
        assert "python-can is not installed" in board(tmp_path).sentence
    with monkeypatch.context() as patch:
        patch.setattr(os, "access", lambda *_: False)
        assert "may not be opened" in board(tmp_path).sentence
    assert adapter.received == []
    assert "whether the board answers" in board(tmp_path).sentence, "and is opened"


# ---- currents


@pytest.mark.parametrize(
    ("moving", "says"),
    [
        ({"11": 0.009, "12": 0.008, "61": 0.4}, "output for servo 61 feeds it (392 mA"),
        ({"11": 0.009, "12": 0.4, "61": 0.008}, "feeds another servo, or none"),
        ({"61": 0.04}, "has measured no current of servo 61"),
        ({}, "has measured no current of servo 61"),
    ],
)
def test_the_highest_currents_show_which_output_feeds_a_servo(moving: dict[str, float], says: str) -> None:
    def report(amperes: dict[str, float | None]) -> Telemetry:
        servos = {name: ServoTelemetry(supplied=True, current_a=each) for name, each in amperes.items()}
        return Telemetry(time=dt.datetime.now(dt.UTC), age_ms=0, servos=servos)

    rest = [report({"11": 0.008, "12": 0.008, "61": 0.008}), report({"61": 0.003, "12": None})]
    assert says in output(rest, [report(dict(moving)), report(dict.fromkeys(moving, 0.001))], 61)
