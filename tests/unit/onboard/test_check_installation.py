"""`check`: what is judged of an installation, row by row, and what is looked at for it (all on a robot: tests/box)."""

import hashlib
import shlex
from dataclasses import replace
from pathlib import Path

import pytest

from gateway import certs
from gateway.onboard import whole
from gateway.onboard.check import trust
from gateway.onboard.check.installation import FAULTS, SHIPPED, DropIn, Folder, Installation, results
from gateway.onboard.check.result import Verdict
from gateway.onboard.whole import Whole
from gateway.robot.sections import ZenohSettings

UNITS = {
    name: {"LoadState": "loaded", "ActiveState": "active", "UnitFileState": "enabled", "NeedDaemonReload": "no"}
    for name in ("hexapod-gateway",)
}
WELL = Installation(release="/opt/R", deploy="/opt/R/deploy", again="sudo bash install.sh --wheels W", units=UNITS)
UNIT = SHIPPED[0].place


def units(name: str, **changed: str) -> dict[str, dict[str, str]]:
    return {**UNITS, name: {**UNITS[name], **changed}}


def with_drop_in(text: str) -> Installation:
    return replace(WELL, drop_ins=(DropIn.of("/etc/x.conf", text),))


SEEN = (
    (replace(WELL, whole=Whole(listed=True, changed=("a.py",))), "not as installed in /opt/R: a.py."),
    (replace(WELL, whole=Whole(listed=True, changed=("a", "b", "c", "d", "e"))), "a, b, c and 2 more"),
    (replace(WELL, whole=Whole(listed=False)), "/opt/R has no list of its files"),
    (replace(WELL, whole=Whole(listed=True, added=("lib/x.pth",))), "and not installed with it: lib/x.pth"),
    (replace(WELL, whole=Whole(listed=True, closed=("lib/x.py",))), "not for all to read, or not for root alone"),
    (replace(WELL, command="is missing"), "/usr/local/bin/hexapod-gateway is missing"),
    (replace(WELL, user=False), "there is no user hexapod-gateway"),
    (replace(WELL, groups=("spi",)), "there is no group spi"),
    (
        replace(WELL, units=units("hexapod-gateway", LoadState="masked")),
        "hexapod-gateway is masked, or its unit is empty",
    ),
    (replace(WELL, differ={UNIT: "is missing"}), f"{UNIT} is missing"),
    (replace(WELL, units=units("hexapod-gateway", NeedDaemonReload="yes")), "hexapod-gateway was edited, and systemd"),
    (with_drop_in("[Service]\nEnvironment=GATEWAY_OPTIONS=--sim\nExecStopPost="), "makes the controller a simulated"),
    (with_drop_in("[Service]\nExecStopPost="), "empties ExecStopPost="),
    (with_drop_in("[Service]\nEnvironment=HEXAPOD_SPI__FRAMING=plain"), "has settings, which hold in place of"),
    (with_drop_in("[Service]\nUser=root\nNice=3"), "changes what Stops depend on: Nice, User"),
    (replace(WELL, state=Folder(is_folder=False)), "is no folder"),
    (replace(WELL, state=Folder(read_only_mount="/var", writable=False)), "on a file system that is read-only"),
    (replace(WELL, state=Folder(owned=False, foreign=("a",))), "is not the service's to write"),
    (replace(WELL, state=Folder(foreign=("a",))), "not the service's to read and write: a"),
    (replace(WELL, exposed=("/etc/a.key",)), "others than root and the service may read /etc/a.key"),
    (replace(WELL, authority_keys=("/etc/ca.key",)), "/etc/ca.key is the authority's key"),
)


@pytest.mark.parametrize(("seen", "sentence"), SEEN, ids=[sentence for _, sentence in SEEN])
def test_each_fault_is_one_line_whose_remedy_is_a_command(seen: Installation, sentence: str) -> None:
    (found,) = results(seen)
    assert sentence in found.sentence
    assert found.verdict is not Verdict.OK
    begin = found.fix.index("sudo ")
    assert shlex.split(found.fix[begin:])
    assert "{" not in found.fix


def test_each_row_of_the_table_is_reached_and_a_robot_that_is_well_has_none() -> None:
    assert list(results(WELL)) == []
    assert [row for row in FAULTS if not any(list(row.found(seen)) for seen, _ in SEEN)] == []


@pytest.mark.parametrize(
    "text",
    [
        "",
        "# ExecStopPost=\n[Service]\n;User=root\nMemoryMax=1G\n",
        "[Service]\nEnvironment=LANG=C\n",
    ],
)
def test_a_drop_in_that_no_stop_depends_on_is_a_persons_own(text: str) -> None:
    assert list(results(with_drop_in(text))) == []


def test_a_drop_in_may_empty_what_comes_after_the_end_if_it_brings_the_stops_back() -> None:
    text = "[Service]\nExecStopPost=\nExecStopPost=/opt/x \\\n  stop-servos\n"
    (found,) = results(with_drop_in(text))
    assert "changes what Stops depend on: ExecStopPost" in found.sentence


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
    assert whole.compare(release) == Whole(listed=True, closed=mine)
    (release / "lib/a.py").write_text("")
    (release / "lib/b.py").unlink()
    (release / "lib/a.py").chmod(0o664)
    (release / "bin/c").chmod(0o646)
    (release / "lib/__pycache__").mkdir()
    for name in ("lib/more.pth", "lib/notes.txt", "lib/__pycache__/a.py"):
        (release / name).touch()
    found = whole.compare(release)
    assert (found.changed, found.added) == (("lib/a.py", "lib/b.py"), ("lib/more.pth",))
    assert {"lib/a.py", "bin/c"} <= set(found.closed)
    (release / "complete").write_text("")
    assert whole.compare(release) == Whole(listed=False)


def test_how_to_repeat_an_installation_is_a_command_while_its_source_is_there(tmp_path: Path) -> None:
    source = tmp_path / "the wheels"
    source.mkdir()
    (tmp_path / "again").write_text(f"bash /bin/true --wheels '{source}'\n")
    assert whole.how_to_repeat(tmp_path) == f"sudo bash /bin/true --wheels '{source}'"
    source.rmdir()
    assert whole.how_to_repeat(tmp_path).endswith(": sudo deploy/install.sh")
    assert whole.how_to_repeat(source).endswith(": sudo deploy/install.sh")


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
        """What is said once these of the other's files have taken the place of the robot's own."""
        for name in names:
            (self.own / name).write_bytes((self.other / name).read_bytes())
        found = trust.results(ZenohSettings(config=str(self.own / "gateway.json5")), state=self.state)
        assert all("sudo " in each.fix for each in found)
        return [each.sentence.replace(f"{self.own}/", "") for each in found]


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
    assert trust.results(ZenohSettings(), state=None) == []
