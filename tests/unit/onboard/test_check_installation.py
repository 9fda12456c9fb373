"""`check`: an installation below a folder; and what `--move` says of the power board's currents."""

import datetime as dt
import os
from collections.abc import Callable
from pathlib import Path

import pytest

from gateway import certs
from gateway.onboard import whole
from gateway.onboard.check.installation import AS_ROOT, unit
from gateway.onboard.check.move import output
from gateway.onboard.check.table import CheckedRobot, Result, Verdict, results
from gateway.onboard.whole import Whole
from schemas.telemetry import ServoTelemetry, Telemetry

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
    (lambda _: None, ""),
    (lambda robot: robot.drop_in("# ExecStopPost=\n;User=root\nCPUWeight=9"), ""),
    (lambda robot: robot.drop_in("Environment=LANG=C"), ""),
)
"""Each fault with its sentence, and last what is well."""


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
    lines = found(robot)
    assert len(lines) == bool(sentence), lines
    for line in lines:
        assert sentence in line.sentence
        assert "sudo " in line.fix or "systemctl cat" in line.fix


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
