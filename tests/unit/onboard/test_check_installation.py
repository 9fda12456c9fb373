"""`check`: what an installation is, read from files below a folder, and certificates that belong together or not."""

import hashlib
import os
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest

from gateway import certs
from gateway.onboard import whole
from gateway.onboard.check import certificates, installation, laptop
from gateway.onboard.check.installation import PROBES, UNIT
from gateway.onboard.check.release import SHIPPED
from gateway.onboard.check.table import CheckedRobot, Result, Verdict, results
from gateway.onboard.whole import Whole
from gateway.people.client.requests import Identity
from gateway.robot.settings import Settings
from gateway.robot.zenoh_io import revoked
from schemas.telemetry import RevocationsReport
from tests.support.certs_folder import NOW, make_folder

__all__ = ["make_folder"]  # a fixture

UP = {"LoadState": "loaded", "ActiveState": "active", "UnitFileState": "enabled", "NeedDaemonReload": "no"}
UP |= {"ExecStopPost": "{ path=/run/program ; argv[]=/run/program stop-servos }"}
DROP_IN = "/etc/systemd/system/hexapod-gateway.service.d/own.conf"
STATE = "var/lib/hexapod-gateway"


class Installed(CheckedRobot):
    """A release in a folder, with what systemd would show of its units. Its user is the one that runs this."""

    def __init__(self, root: Path) -> None:
        release = root / "opt/hexapod-gateway/venv-1"
        for each in SHIPPED:
            for path in (release / "deploy" / each.source, root / each.place.lstrip("/")):
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_text(each.source)
        (release / "complete").write_text(f"{hashlib.sha256(b'#').hexdigest()}  ./bin/hexapod-gateway\n")
        (release / "bin").mkdir()
        (release / "bin/hexapod-gateway").write_text("#")
        (root / "run/systemd/system").mkdir(parents=True)
        self.root = root
        self.write("run/program", "#!/run/program", 0o755)
        (release / "bin/hexapod-gateway").chmod(0o755)
        (root / "opt/hexapod-gateway/venv").symlink_to("venv-1")
        (root / "usr/local/bin").mkdir(parents=True)
        (root / "usr/local/bin/hexapod-gateway").symlink_to(release / "bin/hexapod-gateway")
        (root / STATE).mkdir(parents=True)
        super().__init__(root=root)
        self.service = os.getuid(), os.getgid()
        self.unit: dict[str, str] = dict(UP)
        self.manager: dict[str, str] = {}

    def drop_in(self, text: str) -> None:
        path = self.path(DROP_IN)
        path.parent.mkdir()
        path.write_text(f"[Service]\n{text}\n")
        self.unit["DropInPaths"] = DROP_IN

    def shown(self, **properties: str) -> None:
        self.unit.update(properties)

    def write(self, name: str, text: str = "", mode: int = 0o600) -> None:
        path = self.root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
        path.chmod(mode)

    def keys(self, name: str) -> None:
        certs.folder.init(self.root / "C", ["127.0.0.1"])
        for source, target in (("ca.key", name), ("ca.pem", "ca.pem")):
            self.write(f"etc/hexapod-gateway/zenoh/{target}", (self.root / "C" / source).read_text())

    def file_for_folder(self) -> None:
        (self.root / STATE).rmdir()
        self.write(STATE)

    def runs(self, variables: str) -> None:
        self.write("proc/7/environ", variables)
        self.shown(MainPID="7")

    def forget_python(self) -> None:
        self.write("x", "#!/usr/bin/python3.1 -I\n", 0o755)
        self.shown(ExecStart="{ path=/x ; argv[]=/x }")

    def forget(self, name: str) -> None:
        (self.root / name).unlink()


Plant = Callable[[Installed], object]
PLANTED: tuple[tuple[Plant, str], ...] = (
    (lambda robot: robot.write("opt/hexapod-gateway/venv-1/bin/hexapod-gateway", "x", 0o755), "not as installed in"),
    (lambda robot: robot.write("opt/hexapod-gateway/venv-1/complete"), "not as installed in"),
    (lambda robot: robot.write("opt/hexapod-gateway/venv-1/lib/x.pth"), "and not installed with it: lib/x.pth"),
    (lambda robot: robot.write("opt/hexapod-gateway/venv-1/bin/hexapod-gateway", "#", 0o666), "not for all to read"),
    (lambda robot: robot.forget("usr/local/bin/hexapod-gateway"), "/usr/local/bin/hexapod-gateway is missing"),
    (lambda robot: robot.forget("etc/systemd/system/hexapod-gateway.service"), "hexapod-gateway.service is missing"),
    (lambda robot: robot.write("etc/systemd/system/hexapod-gateway.service"), "gateway.service is not as this"),
    (lambda robot: robot.shown(ExecStart="{ path=/none ; argv[]=/none }"), "/none cannot be run"),
    (lambda robot: robot.forget_python(), "/usr/bin/python3.1 cannot be run"),
    (lambda robot: robot.shown(ExecStopPost="{ path=/run/program ; }"), "runs no stop-servos after its end"),
    (lambda robot: robot.shown(LoadState="masked"), "hexapod-gateway is masked, or its unit is empty"),
    (lambda robot: robot.shown(NeedDaemonReload="yes"), "hexapod-gateway was edited, and systemd still"),
    (lambda robot: robot.drop_in("Environment=GATEWAY_OPTIONS=--sim\nExecStopPost="), "makes the controller a simu"),
    (lambda robot: robot.drop_in("ExecStopPost="), "empties ExecStopPost="),
    (lambda robot: robot.drop_in("Environment=HEXAPOD_SPI__FRAMING=plain"), "has settings, which hold in place of"),
    (lambda robot: robot.drop_in("User=root\nNice=3"), "changes what Stops depend on: Nice, User"),
    (lambda robot: robot.drop_in("Environment=A=1 PYTHONPATH=/x\nMemoryMax=64M"), "depend on: MemoryMax, PYTHONPATH"),
    (lambda robot: robot.drop_in("ExecStopPost=\nExecStopPost=/opt/x \\\n  stop-servos"), "depend on: ExecStopPost"),
    (lambda robot: robot.runs("A=1\0HEXAPOD_SPI__FRAMING=plain\0"), "HEXAPOD_SPI__FRAMING is in the service's env"),
    (lambda robot: robot.manager.update(Environment="PATH=/bin HEXAPOD_LOG__LEVEL=debug"), "HEXAPOD_LOG__LEVEL is in"),
    (lambda robot: robot.runs("PYTHONPATH=/x\0"), "PYTHONPATH is in the service's environment"),
    (lambda robot: robot.file_for_folder(), "is no folder"),
    (lambda robot: robot.path(STATE).chmod(0o500), "is not the service's to write"),
    (lambda robot: robot.write(f"{STATE}/a", mode=0o400), "not the service's to read and write: a"),
    (lambda robot: robot.write("etc/hexapod-gateway/a.key", mode=0o604), "others than root and the service may read"),
    (lambda robot: robot.keys("old.key"), "zenoh/old.key is the authority's key"),
    (lambda robot: robot.keys("ca.key"), "zenoh/ca.key is the authority's key"),
)
FINE: tuple[Plant, ...] = (
    lambda _: None,
    lambda robot: robot.drop_in("# ExecStopPost=\n;User=root\nCPUWeight=9"),
    lambda robot: robot.drop_in("Environment=LANG=C"),
    lambda robot: robot.write("etc/hexapod-gateway/gateway.toml", "[spi]\nframing = 7\n"),
)


def found(robot: Installed) -> list[Result]:
    """Without what is so of this machine: a folder that a boot empties, and files that are not root's."""
    lines = [each for each in results([*PROBES, UNIT], robot) if each.name != "user" and each.verdict is not Verdict.OK]
    return [each for each in lines if "which a boot empties" not in each.sentence and (not os.getuid() or (
        "not for root alone" not in each.sentence
    ))]  # fmt: skip


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


def test_settings_that_are_new_are_named(tmp_path: Path) -> None:
    robot = Installed(tmp_path)
    text = installation.TEMPLATE.read_text()
    robot.write("etc/hexapod-gateway/gateway.toml", text.replace("# max_age_ms = ", "# ").replace("# speed_hz =", "#"))
    (line,) = (each for each in results(PROBES, robot) if each.name == "settings")
    assert line.sentence.endswith("whose defaults hold: limits.max_age_ms, spi.speed_hz")


def test_a_state_directory_in_memory_is_known() -> None:
    with tempfile.TemporaryDirectory(dir="/dev/shm") as folder:
        lines = results(PROBES, Installed(Path(folder)))
        assert "is on tmpfs, which a boot empties" in " ".join(each.sentence for each in lines)


def test_the_file_system_of_a_folder_is_known() -> None:
    mount, kind = installation.mount_of(Path("/proc/self"))
    assert (mount, kind) == ("/proc", "proc")


@pytest.fixture
def release(tmp_path: Path) -> Path:
    for name in ("lib/a.py", "lib/b.py", "bin/c"):
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(name)
        path.chmod(0o644)
    digests = {name: hashlib.sha256(name.encode()).hexdigest() for name in ("lib/a.py", "lib/b.py", "bin/c")}
    (tmp_path / "complete").write_text("".join(f"{digest}  ./{name}\n" for name, digest in digests.items()))
    return tmp_path


def test_a_release_is_compared_with_its_list(release: Path) -> None:
    mine = () if (release / "bin/c").stat().st_uid == 0 else ("lib/a.py", "lib/b.py", "bin/c")
    assert whole.compare(release) == Whole(closed=mine)
    (release / "lib/a.py").write_text("")
    (release / "lib/b.py").unlink()
    (release / "lib/a.py").chmod(0o664)
    (release / "bin/c").chmod(0o646)
    (release / "lib/__pycache__").mkdir()
    for name in ("lib/more.pth", "lib/notes.txt", "lib/__pycache__/a.py"):
        (release / name).touch()
    compared = whole.compare(release)
    assert (compared.changed, compared.added) == (("lib/a.py", "lib/b.py"), ("lib/more.pth",))
    assert {"lib/a.py", "bin/c"} <= set(compared.closed)
    (release / "complete").write_text("")
    assert whole.compare(release) == Whole(changed=("complete",))


def test_how_to_repeat_an_installation_is_a_command_while_its_source_is_there(tmp_path: Path) -> None:
    source = tmp_path / "the wheels"
    source.mkdir()
    (tmp_path / "again").write_text(f"bash /bin/true --wheels '{source}'\n")
    assert whole.how_to_repeat(tmp_path) == f"sudo bash /bin/true --wheels '{source}'"
    source.rmdir()
    assert whole.how_to_repeat(tmp_path).endswith(": sudo deploy/install.sh")
    assert whole.how_to_repeat(source).endswith(": sudo deploy/install.sh")


# ---- certificates


def of(folder: Path, state: Path | None = None) -> CheckedRobot:
    sections = {"zenoh": {"config": str(folder / "gateway.json5")}, "state": {"path": str(state) if state else ""}}
    return CheckedRobot(Settings.model_validate(sections))


class Folders:
    """A robot's certificates, and those of another authority."""

    def __init__(self, folder: Path) -> None:
        self.own, self.other, self.state = folder / "own", folder / "other", folder / "state"
        self.state.mkdir()
        for each in (self.own, self.other):
            certs.folder.init(each, ["127.0.0.1"])
            certs.folder.issue(each, "anna", "operator")
            certs.folder.revoke(each, "anna")

    def bring(self, *names: str) -> list[str]:
        """What is not well once these of the other's files have taken the place of the robot's own."""
        for name in names:
            (self.own / name).write_bytes((self.other / name).read_bytes())
        found = results(certificates.CERTIFICATES[1:], of(self.own, self.state))
        lines = [each for each in found if each.verdict is not Verdict.OK]
        assert all("sudo " in each.fix for each in lines)
        return [each.sentence.replace(f"{self.own}/", "") for each in lines]


def test_certificate_key_authority_and_lists_have_to_belong_together(tmp_path: Path) -> None:
    folders = Folders(tmp_path)
    assert folders.bring() == []
    assert folders.bring("gateway.key") == ["gateway.key is not the key of gateway.pem: nobody can connect"]
    assert folders.bring("gateway.pem") == ["gateway.pem is of another authority than ca.pem: nobody can connect"]
    (folders.state / "revoked.crl").write_text("x")
    assert folders.bring("ca.pem") == [
        f"{folders.state}/revoked.crl: this is no list of `hexapod-gateway certs revoke`, or it was cut off; "
        "the service does not start",
        "revoked.crl is of another authority, so nobody is shut out by it",
    ]
    (folders.own / "ca.pem").write_text("")
    assert folders.bring() == [], "another line says it"
    assert list(results(certificates.CERTIFICATES[1:], CheckedRobot(Settings()))) == []


def test_the_list_in_force_is_named_with_its_number_and_date_and_that_there_is_none(folder: Path) -> None:
    shut_out = partial(results, certificates.CERTIFICATES[2:], of(folder))
    certs.folder.issue(folder, "anna", "operator", now=NOW)
    (none,) = shut_out()
    assert (none.verdict, none.sentence.partition(":")[0]) == (Verdict.OK, "there is no list")
    certs.folder.revoke(folder, "anna", now=NOW)
    revoked.keep(folder / "revoked.crl", certs.folder.revoke(folder, "operator-40", now=NOW))
    (two,) = shut_out()
    assert (two.verdict, two.sentence) == (Verdict.OK, f"list 2 of {NOW:%Y-%m-%d} shuts out 2")


@pytest.mark.parametrize(("number", "verdict"), [(None, Verdict.WARNING), (1, Verdict.WARNING), (2, Verdict.OK)])
def test_a_laptop_beside_the_ca_sees_that_the_robot_has_an_older_list(
    folder: Path, number: int | None, verdict: Verdict
) -> None:
    identity = Identity(folder / "anna.pem", ca=folder / "ca.pem")
    certs.folder.revoke(folder, "operator-40", now=NOW)
    certs.folder.revoke(folder, "operator-41", now=NOW)
    report = None if number is None else RevocationsReport(number=number, date=NOW)
    (line,) = laptop.shut_out(report, identity)
    assert line.verdict is verdict
    assert ("names no list" if number is None else f"list {number} of") in line.sentence
    assert ("certs revoke --dir" in line.fix) is (verdict is Verdict.WARNING)
