"""`setup` on a folder as the robot's computer: what it writes, what it leaves alone, and in which sentences."""

import contextlib
import datetime as dt
import io
import os
import re
import shutil
import stat
import subprocess
import tomllib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest

from gateway import certs
from gateway.certs import access, authority
from gateway.errors import ConfigError, GatewayError
from gateway.onboard.setup import Wanted, setup
from gateway.onboard.setup.boot import overlay_is_on, spi_is_on, with_line
from gateway.onboard.setup.configuration import with_value
from gateway.onboard.setup.machine import Machine
from gateway.people.commands import certs as commands
from tests.support.certs_folder import contents

TOML = "/etc/hexapod-gateway/gateway.toml"
TEMPLATE = Path(__file__).parents[3] / "deploy/gateway.toml"
CONFIG_TXT = "/boot/firmware/config.txt"
ZENOH = "/etc/hexapod-gateway/zenoh"
ROBOTS_FILES = ("gateway.pem", "gateway.key", "ca.pem", "gateway.json5")
STOCK = "# Raspberry Pi OS\n#dtparam=spi=on\ndtoverlay=vc4-kms-v3d\n"


class Systemd:
    """Starts what it is asked to, unless `is_broken`; `calls` are the changes that it was asked for."""

    def __init__(self) -> None:
        self.units: dict[str, dict[str, str]] = {}
        self.calls: list[str] = []
        self.is_broken: Callable[[], bool] = lambda: False
        self.journal = ""

    def unit(self, name: str, **properties: str) -> None:
        self.units.setdefault(name, {}).update(properties)

    def __call__(self, command: Sequence[str]) -> "subprocess.CompletedProcess[str]":
        if command[0] == "journalctl":
            return subprocess.CompletedProcess(command, 0, self.journal, "")
        _, verb, *words = command
        names = [each for each in words if not each.startswith("--")]
        if verb == "show":
            name = words[0].removeprefix("--property=")
            return subprocess.CompletedProcess(command, 0, self.units.get(names[0], {}).get(name, ""), "")
        self.calls.append(" ".join([verb, *words]))
        if verb == "restart" and self.is_broken():
            return subprocess.CompletedProcess(command, 1, "", "Job failed")
        changed = {"enable": {"UnitFileState": "enabled"}, "restart": {"ActiveState": "active"}}.get(verb, {})
        for each in names:
            self.unit(each, **changed)
        return subprocess.CompletedProcess(command, 0, "", "")


class _Checked(Machine):
    """`check` is another program, of which only the call counts here."""

    def check(self) -> int:
        print("(check)")
        return 0


class Computer:
    """The folder, with the package installed and nothing set up."""

    def __init__(self, root: Path) -> None:
        self.root, self.systemd, self.busy = root, Systemd(), ""
        gid = os.getgid()
        self.write("/etc/group", f"root:x:0:\nhexapod-gateway:x:{gid}:\nhexapod-console:x:{gid}:\n")
        self.write(TOML, TEMPLATE.read_text(), 0o640)
        (root / "etc/hexapod-gateway").chmod(0o750)

    def write(self, path: str, text: str, mode: int = 0o644) -> Path:
        file = self.root / path.lstrip("/")
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
        file.chmod(mode)
        return file

    def read(self, path: str) -> str:
        return (self.root / path.lstrip("/")).read_text()

    def says(self, *, dry: bool = False, force: bool = False, **wanted: Any) -> list[str]:
        """Return the lines that `setup` prints, which ends with 0."""
        machine = _Checked(self.root, self.systemd, lambda: self.busy, dry=dry, force=force)
        with contextlib.redirect_stdout(io.StringIO()) as stdout:
            assert setup(machine, Wanted(**wanted)) == 0
        return stdout.getvalue().splitlines()


@pytest.fixture
def computer(tmp_path: Path) -> Computer:
    return Computer(tmp_path)


# ---- text


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("", '\n[spi]\nframing = "plain"\n'),
        ('[spi]\nframing = "x" # mine\n', '[spi]\nframing = "plain" # mine\n'),
        ('[spi]\n# framing = "x"\n# a comment\n', '[spi]\nframing = "plain"\n# a comment\n'),
        (
            "[ spi ]\nspeed_hz = 1\n[lease]\n# framing = 1\n",
            '[ spi ]\nframing = "plain"\nspeed_hz = 1\n[lease]\n# framing = 1\n',
        ),
        (
            "spi.speed_hz = 1\n[lease]\nttl_ms = 900\n",
            'spi.framing = "plain"\nspi.speed_hz = 1\n[lease]\nttl_ms = 900\n',
        ),
        ("spi.framing = 'x'\n", 'spi.framing = "plain"\n'),
    ],
)
def test_one_value_changes_and_everything_else_stays(before: str, after: str) -> None:
    changed = with_value(before, "spi", "framing", "plain")
    assert changed.lstrip("\n") == after.lstrip("\n")


@pytest.mark.parametrize(
    ("config", "is_on"),
    [
        ("dtparam=spi=on\n", True),
        ("[cm4]\notg_mode=1\n[all]\ndtparam=spi=on\n", True),
        ("dtparam=spi\n", True),
        ("dtparam=spi=off\n", False),
        ("dtparam=spi=on\ndtparam=spi=off\n", False),
        (STOCK, False),
        ("[cm4]\ndtparam=spi=on\n", False),
    ],
)
def test_spi_is_on_or_is_switched_on_for_every_pi(config: str, is_on: bool) -> None:
    """Outside any filter, and not as a parameter of the overlay before it."""
    assert spi_is_on(config) is is_on
    switched = with_line(config, "all", "dtparam=spi=on")
    assert spi_is_on(switched)
    assert switched.startswith(config)
    assert switched.endswith("[all]\ndtoverlay=\ndtparam=spi=on\ndtoverlay=\n[all]\n")


# ---- a whole run


def test_setup_makes_a_robot_of_a_new_pi(computer: Computer) -> None:
    """A dry run states the same changes and makes none; a second run has nothing to change."""
    computer.write(CONFIG_TXT, STOCK)
    before = contents(computer.root)
    promised = computer.says(dry=True, framing="plain")
    assert (contents(computer.root), computer.systemd.calls) == (before, [])
    done = computer.says(framing="plain")
    assert done[:-1] == promised[:-1]
    assert done == [
        f'write {TOML}: with spi.framing = "plain"',
        f"switch /dev/spidev0.0 on (dtparam=spi=on) in {CONFIG_TXT}: a reboot is due",
        "enable hexapod-gateway: starts with the machine",
        "the service starts with the reboot",
        "Next: sudo reboot; then: sudo hexapod-gateway check",
    ]
    assert computer.read(TOML) == TEMPLATE.read_text().replace('# framing = "plain"', 'framing = "plain"')
    assert spi_is_on(computer.read(CONFIG_TXT))
    changed = contents(computer.root)
    assert computer.says() == [
        f'{TOML} states spi.framing = "plain"',
        f"/dev/spidev0.0 is on in {CONFIG_TXT}, but is not there: a reboot is due",
        "the service starts with the reboot",
        "Next: sudo reboot; then: sudo hexapod-gateway check",
    ]
    assert contents(computer.root) == changed


@pytest.mark.parametrize(
    ("state", "files", "options", "line"),
    [
        ("active", {}, {"framing": "length-prefixed"}, "restart the service: all legs stop"),
        ("active", {"/run/hexapod-gateway/gateway.toml": ""}, {}, "restart the service: all legs stop"),
        ("activating", {"/dev/spidev0.0": ""}, {}, "start the service"),
    ],
    ids=["another framing", "an interrupted setup left it out", "it is tried again and again"],
)
def test_setup_starts_or_restarts_the_service(
    computer: Computer, state: str, files: dict[str, str], options: dict[str, Any], line: str
) -> None:
    for path, text in {TOML: '# mine\nspi.framing = "plain"\n', **files}.items():
        computer.write(path, text, 0o640)
    computer.systemd.unit("hexapod-gateway", ActiveState=state, UnitFileState="enabled")
    assert line in computer.says(**options)
    assert computer.read(TOML) == f'# mine\nspi.framing = "{options.get("framing", "plain")}"\n'


def test_while_a_servo_runs_nothing_changes(computer: Computer) -> None:
    computer.write("/dev/spidev0.0", "")
    computer.systemd.unit("hexapod-gateway", ActiveState="active", UnitFileState="enabled")
    computer.busy = "a servo runs"
    before = contents(computer.root)
    with pytest.raises(GatewayError, match="a servo runs, and a restart would stop it: stop the robot"):
        computer.says(framing="plain")
    assert contents(computer.root) == before
    computer.says(framing="plain", force=True)
    assert computer.systemd.calls[-1] == "restart hexapod-gateway"
    computer.says(framing="plain")  # there is nothing to restart it for


@pytest.mark.parametrize(
    ("text", "options", "fault"),
    [
        ("", {}, "which wire does the controller need\\? Use --wire hexapod-1.0 or elkapod-2025"),
        ("", {"wire": "hexapod-1.0"}, "which framing does the controller need\\? Use --framing"),
        ("", {"wire": "elkapod-2025", "framing": "plain"}, "--framing is for hexapod-1.0"),
        ("framing = ", {"framing": "plain"}, "gateway.toml is not TOML"),
        ("spi = 1", {"framing": "plain"}, "is no table"),
        ("spi = {}", {"framing": "plain"}, "a person must change"),
        ("", {"framing": "plain", "certs": Path("/nowhere.zip")}, "there is no /nowhere.zip"),
    ],
)  # fmt: skip
def test_setup_rejects_a_wrong_file_or_option_in_a_sentence(
    computer: Computer, text: str, options: dict[str, Any], fault: str
) -> None:
    computer.write(TOML, text or TEMPLATE.read_text(), 0o640)
    with pytest.raises(ConfigError, match=fault):
        computer.says(**options)
    assert computer.systemd.calls == []


def test_at_a_terminal_it_asks_until_the_answer_is_one(computer: Computer, monkeypatch: pytest.MonkeyPatch) -> None:
    """Wire and framing, with what each means; and no question whose answer the file has."""
    answers = ["spi", "hexapod-1.0", "", "plain"]
    monkeypatch.setattr("sys.stdin.isatty", lambda: True)
    monkeypatch.setattr("builtins.input", lambda _: answers.pop(0))
    said = "\n".join(computer.says())
    assert said.index("Which wire does the controller need?") < said.index("Which framing does the controller need?")
    assert "length-prefixed  the published STM32 firmware" in said
    tables = tomllib.loads(computer.read(TOML))
    assert (tables["spi"], tables["wire"]) == ({"framing": "plain"}, {"name": "hexapod-1.0"})
    computer.says()
    assert answers == []


def test_without_an_answer_setup_names_the_option(computer: Computer, monkeypatch: pytest.MonkeyPatch) -> None:
    def end(_: str) -> str:
        raise EOFError

    monkeypatch.setattr("sys.stdin.isatty", lambda: True)
    monkeypatch.setattr("builtins.input", end)
    with pytest.raises(ConfigError, match="nobody answered: use --wire"):
        computer.says()


def test_an_empty_file_is_made_anew(computer: Computer) -> None:
    """A power cut leaves some files empty, or full of zeros."""
    computer.write(TOML, "\0" * 100, 0o640)
    computer.says(framing="plain")
    assert tomllib.loads(computer.read(TOML))["spi"] == {"framing": "plain"}


def test_setup_reports_why_the_service_does_not_start(computer: Computer) -> None:
    computer.write("/dev/spidev0.0", "")
    computer.systemd.is_broken = lambda: True
    computer.systemd.journal = "hexapod-gateway: spi.speed_hz is too fast\nsomething else\n"
    with pytest.raises(GatewayError, match=r"hexapod-gateway does not start: spi.speed_hz is too fast; journalctl"):
        computer.says(framing="plain")


def test_setup_switches_on_and_frees_the_elkapods_uart(computer: Computer) -> None:
    """On a Pi 5: by an overlay; console and login are removed from the UART."""
    computer.write(CONFIG_TXT, "dtparam=spi=on\n")
    computer.write("/proc/device-tree/model", "Raspberry Pi 5 Model B Rev 1.0\0")
    computer.write("/boot/firmware/cmdline.txt", "console=ttyAMA1,115200 console=tty1 root=PARTUUID=1\n")
    computer.systemd.unit("serial-getty@ttyAMA1.service", ActiveState="active")
    computer.says(wire="elkapod-2025")
    assert tomllib.loads(computer.read(TOML))["wire"] == {"name": "elkapod-2025"}
    assert overlay_is_on(computer.read(CONFIG_TXT), "uart1-pi5")
    assert not overlay_is_on("[pi4]\ndtoverlay=uart1-pi5\n", "uart1-pi5")
    assert computer.read("/boot/firmware/cmdline.txt") == "console=tty1 root=PARTUUID=1\n"
    assert "disable --quiet --now serial-getty@ttyAMA1.service" in computer.systemd.calls
    assert f"/dev/ttyAMA1 is on in {CONFIG_TXT}, but is not there: a reboot is due" in computer.says(dry=True)


def test_files_of_the_former_installer_are_removed(computer: Computer) -> None:
    """Its units would hide the package's. Without a package they stay, since they run the robot."""
    unit = computer.write("/etc/systemd/system/hexapod-gateway.service", "")
    computer.write("/opt/hexapod-gateway/venv-1/bin/hexapod-gateway", "")
    computer.says(framing="plain")
    assert unit.exists()
    computer.write("/usr/lib/systemd/system/hexapod-gateway.service", "")
    computer.says()
    assert not unit.exists()
    assert not (computer.root / "opt/hexapod-gateway").exists()
    assert "daemon-reload" in computer.systemd.calls


@pytest.fixture(params=[0o022, 0o077], ids="{:03o}".format)
def umask(request: pytest.FixtureRequest) -> Iterator[None]:
    before = os.umask(request.param)
    yield
    os.umask(before)


@pytest.mark.usefixtures("umask")
def test_setup_starts_the_console(computer: Computer) -> None:
    assert computer.says(dry=True, framing="plain", console=True)[-4:-1] == [
        "write /etc/hexapod-console/console.conf",
        "enable hexapod-console.service and hexapod-console.socket: starts with the machine",
        "start the console; a link for a browser: sudo hexapod-gateway console --link",
    ]
    computer.write("/var/lib/hexapod-console/console-8080.json", "")  # it listens
    computer.says(framing="plain", console=True)
    assert "CONSOLE_OPTIONS=" in computer.read("/etc/hexapod-console/console.conf")
    assert "restart hexapod-console.service" in computer.systemd.calls
    assert "the console runs" in computer.says()


# ---- certificates


@pytest.fixture(scope="module")
def people(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder of certificates: the first robot, a second one, a laptop, and another authority."""
    folder = tmp_path_factory.mktemp("people") / "certs"
    certs.folder.init(folder, ["robot.local"])
    certs.folder.issue(folder, "robot-2", "robot", hosts=["robot-2.local"], bundle=folder / "robot-2.zip")
    certs.folder.issue(folder, "anna", "operator", bundle=folder / "anna.zip")
    (folder / "other.pem").write_bytes(authority.make_ca(dt.datetime.now(dt.UTC)).certificate_pem())
    return folder


@pytest.mark.parametrize("source", [".", "robot-2", "robot-2.zip"])
def test_certificates_come_at_any_time(computer: Computer, people: Path, source: str) -> None:
    computer.says(framing="plain")
    said = computer.says(certs=people / source)
    assert any("has ca.key" in line for line in said) == (source == ".")
    assert tomllib.loads(computer.read(TOML))["zenoh"]["config"] == f"{ZENOH}/gateway.json5"
    for name in ROBOTS_FILES:
        assert stat.S_IMODE((computer.root / ZENOH.lstrip("/") / name).stat().st_mode) == 0o640
    again = computer.says(certs=people / source)
    assert not [line for line in again if line.startswith(("write ", "keep "))]
    assert f"{ZENOH}/gateway.pem is the same" in again


@pytest.mark.parametrize(
    ("files", "fault"),
    [
        (
            {**dict.fromkeys(ROBOTS_FILES, "."), "gateway.pem": "anna.pem"},
            "gateway.key is not the key of gateway.pem: copy all files of the robot .*, or make them where ca.key",
        ),
        (
            {**dict.fromkeys(ROBOTS_FILES, "robot-2"), "ca.pem": "other.pem"},
            "gateway.pem is of another authority than ca.pem",
        ),
        ({"anna.pem": "anna.pem"}, "has no gateway.pem .* A robot needs its own files"),
        ("anna.pem", "is neither a folder nor a zip"),
        ("anna.zip", r"anna\.zip has no gateway\.pem.* A robot needs its own files"),
    ],
    ids=["a laptop's", "of two authorities", "unzipped", "no zip", "a laptop's zip"],
)
def test_certificates_of_another_authority_are_rejected_before_anything_changes(
    computer: Computer, people: Path, tmp_path_factory: pytest.TempPathFactory, files: dict[str, str] | str, fault: str
) -> None:
    """`files` has the source of each name: a file, or a folder with a file of that name."""
    given = people / files if isinstance(files, str) else tmp_path_factory.mktemp("other")
    for name, source in files.items() if isinstance(files, dict) else ():
        found = people / source
        shutil.copy(found / name if found.is_dir() else found, given / name)
    computer.says(framing="plain")
    before = contents(computer.root)
    with pytest.raises(ConfigError, match=fault):
        computer.says(certs=given)
    assert contents(computer.root) == before


def test_an_unedited_zenoh_file_gets_new_access_rules(computer: Computer, people: Path) -> None:
    """An edited one stays, whatever comes."""
    computer.says(framing="plain", certs=people)
    made = computer.read(f"{ZENOH}/gateway.json5")
    older = access.marked(made.partition("// `setup`")[0].replace("hexapod/state", "hexapod/older").encode())
    file = computer.root / ZENOH.lstrip("/") / "gateway.json5"
    file.write_bytes(older)
    assert access.is_unedited(older)
    assert older != made.encode()
    computer.says()
    assert computer.read(f"{ZENOH}/gateway.json5") == made
    edited = made.replace("7447", "7448")
    file.write_text(edited)
    assert f"keep {ZENOH}/gateway.json5, which somebody has edited" in computer.says(certs=people)
    assert computer.read(f"{ZENOH}/gateway.json5") == edited


def test_the_commands_that_certs_prints_for_a_robot_work(
    computer: Computer, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """`init`, `issue` and `renew` print what to copy, and the `setup` command for the robot."""
    folder = tmp_path / "made"
    computer.says(framing="plain")
    second: dict[str, Any] = {"directory": folder, "host": ["robot-2.local"], "bundle": Path("robot-2.zip")}
    steps: dict[str, Callable[[], None]] = {
        "init": lambda: commands.init(["robot.local"], directory=folder),
        "issue": lambda: commands.issue("robot-2", "robot", **second),
        "issue to a folder": lambda: commands.issue("robot-3", "robot", directory=folder, host=["robot-3.local"]),
        "renew": lambda: commands.renew("robot-3", directory=folder),
    }
    for name, step in steps.items():
        home = tmp_path / f"home of {name}"
        home.mkdir()
        monkeypatch.chdir(home)
        step()
        said = capsys.readouterr().out
        copied = re.search(r"^  scp (.*) \S+:(\S*)$", said, re.MULTILINE)
        taken = re.search(r"^and on the robot: sudo hexapod-gateway setup --certs (\S+)$", said, re.MULTILINE)
        assert copied is not None, said
        assert taken is not None, said
        (home / copied[2]).mkdir(exist_ok=True)
        for each in copied[1].split():
            if Path(each) != Path(taken[1]):
                shutil.copy(each, home / copied[2])
        assert "(check)" in computer.says(certs=Path(taken[1])), name
    assert certs.folder.describe(computer.root / "etc/hexapod-gateway/zenoh/gateway.pem").hosts == ("robot-3.local",)
