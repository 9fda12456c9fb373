"""What is released: every dependency is in the lock with its hashes, and archives say nothing of the machine."""

import hashlib
import io
import re
import tarfile
import tomllib
from pathlib import Path

from gateway.onboard import install_service
from release.build import ROOT, plain_tar
from release.sums import sums

LOCK = ROOT / "deploy" / "lock"
PINNED = re.compile(r"^([a-z0-9-]+)==([^ ]+)( ; .*)? \\$")
OFFERED = re.compile(r"^([A-Za-z0-9_.-]+)")


def pinned(file: Path) -> dict[str, int]:
    """Each name, and how many hashes it has."""
    found: dict[str, int] = {}
    name = ""
    for line in file.read_text().splitlines():
        if line.startswith("    --hash=sha256:"):
            assert re.fullmatch(r"    --hash=sha256:[0-9a-f]{64}( \\)?", line), line
            found[name] += 1
        else:
            match = PINNED.fullmatch(line)
            assert match is not None, line
            name = match[1]
            assert name not in found
            found[name] = 0
    return found


def test_the_lock_has_every_dependency_with_its_hashes() -> None:
    """After a change of pyproject.toml: `make lock`."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    optional = project["optional-dependencies"]
    wanted = [*project["dependencies"], *optional["spi"], *optional["console"], *optional["power"]]
    names = {match[1].lower().replace("_", "-") for each in wanted if (match := OFFERED.match(each)) is not None}
    found = pinned(LOCK / "requirements.txt")
    assert names <= found.keys()
    assert min(found.values()) > 0
    assert pinned(LOCK / "build.txt").keys() == {"setuptools"}
    whole = tomllib.loads((ROOT / "uv.lock").read_text())["package"]
    versions = {each["name"]: each.get("version") for each in whole}
    for line in (LOCK / "requirements.txt").read_text().splitlines():
        match = PINNED.fullmatch(line)
        assert match is None or versions[match[1]] == match[2], f"{line}: make lock"


def test_sums_are_as_sha256sum_reads_them(tmp_path: Path) -> None:
    for name, data in (("b", b"1"), ("a", b"")):
        (tmp_path / name).write_bytes(data)
    text = sums([tmp_path / "b", tmp_path / "a"])
    assert text.splitlines()[0] == f"{hashlib.sha256(b'').hexdigest()}  a"
    assert text.splitlines()[1] == f"{hashlib.sha256(b'1').hexdigest()}  b"


def test_an_archive_says_nothing_of_the_machine() -> None:
    first, second = (
        plain_tar(dict(order), 1_700_000_000) for order in ([("a", b"1"), ("b", b"2")], [("b", b"2"), ("a", b"1")])
    )
    assert first == second
    with tarfile.open(fileobj=io.BytesIO(first)) as archive:
        entries = archive.getmembers()
    assert {(each.mtime, each.uid, each.gid, each.uname, each.mode) for each in entries} == {
        (1_700_000_000, 0, 0, "", 0o644)
    }


def test_the_installer_is_in_the_package_as_it_is_in_the_repository() -> None:
    assert install_service.INSTALLER.resolve() == ROOT / "deploy" / "install.sh"
