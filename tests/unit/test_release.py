"""What is released: every dependency is in the lock with its hashes, and archives say nothing of the machine."""

import hashlib
import io
import re
import tarfile
import tomllib
from pathlib import Path

from release.build import ROOT, plain_tar
from release.sums import sums

OFFERED = re.compile(r"^([A-Za-z0-9_.-]+)")


def test_the_lock_has_every_dependency_with_its_hashes() -> None:
    """After a change of pyproject.toml: `make lock`."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    optional = project["optional-dependencies"]
    wanted = [*project["dependencies"], *optional["spi"], *optional["console"], *optional["power"]]
    names = {match[1].lower().replace("_", "-") for each in wanted if (match := OFFERED.match(each)) is not None}
    locked = {each["name"]: each for each in tomllib.loads((ROOT / "uv.lock").read_text())["package"]}
    assert names <= locked.keys()
    for name in names:
        files = [*locked[name].get("wheels", []), *([locked[name]["sdist"]] if "sdist" in locked[name] else [])]
        assert files
        assert all(re.fullmatch("sha256:[0-9a-f]{64}", each["hash"]) for each in files), name


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
