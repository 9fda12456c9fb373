"""What is released, and which tests run when."""

import io
import os
import re
import tarfile
import tomllib
from pathlib import Path

import pytest

from release.build import ROOT, plain
from tests.support import lacks, schedule

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


def test_an_archive_says_nothing_of_the_machine(tmp_path: Path) -> None:
    for name in "ab":
        (tmp_path / name).write_text(name)
    (tmp_path / "a").chmod(0o750)
    made: list[bytes] = []
    for order in ("ab", "ba"):
        written = io.BytesIO()
        with tarfile.open(fileobj=written, mode="w:gz") as machines:
            for name in order:
                os.utime(tmp_path / name, (len(made), len(made)))
                machines.add(tmp_path / name, name)
        made.append(plain(written.getvalue(), 1_700_000_000))
    assert made[0] == made[1]
    with tarfile.open(fileobj=io.BytesIO(made[0])) as archive:
        entries = archive.getmembers()
    assert [(each.name, each.mode) for each in entries] == [("a", 0o755), ("b", 0o644)]
    assert {(each.mtime, each.uid, each.gid, each.uname) for each in entries} == {(1_700_000_000, 0, 0, "")}


TESTS = Path(__file__).parents[1]
TEST, ALL = "not full and not nightly", "not alone and not attended and not searches and not nightly"


def test_what_is_named_is_there() -> None:
    for place in (*schedule.FOLDERS, *schedule.APART, *schedule.TOGETHER, *schedule.SECOND_BOX):
        assert (TESTS / place).exists(), place


@pytest.mark.parametrize(
    ("file", "text", "marks", "elsewhere"),
    [
        ("zenoh/test_a.py", "", TEST, False),
        ("zenoh/test_a.py", "@pytest.mark.full\ndef test_a(): ...", TEST, False),
        ("zenoh/test_a.py", "pytestmark = pytest.mark.full", TEST, True),
        ("zenoh/test_a.py", "pytestmark = pytest.mark.full", ALL, False),
        ("zenoh/test_a.py", "pytestmark = [\n    pytest.mark.hil,\n    pytest.mark.nightly,\n]", ALL, True),
        ("hil/test_a.py", "", TEST, True),
        ("walking/test_a.py", "", ALL, True),
        ("zenoh/test_a.py", "", "alone and not nightly", True),
        ("zenoh/test_a.py", "@pytest.mark.alone\ndef test_a(): ...", "alone and not nightly", False),
        ("net/data.json", "", "attended", False),
    ],
)
def test_a_file_is_imported_only_where_it_has_tests_that_run(
    file: str, text: str, marks: str, elsewhere: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(schedule, "TESTS", tmp_path)
    (tmp_path / file).parent.mkdir()
    (tmp_path / file).write_text(text)
    assert schedule.is_elsewhere(tmp_path / file, marks) is elsewhere


@pytest.mark.parametrize(
    ("marks", "tiers"),
    [([], set()), (["nightly"], {"nightly"}), (["hil", "nightly"], {"nightly"})]
    + [([name], {"full"}) for name in lacks.LACKS],
)
def test_what_needs_root_or_packages_is_never_in_make_test(
    request: pytest.FixtureRequest, marks: list[str], tiers: set[str]
) -> None:
    """Also a single test, in a folder of which all others need nothing."""
    item = pytest.Function.from_parent(request.node.parent, name="test_one", callobj=lambda: None)
    for mark in marks:
        item.add_marker(mark)
    schedule.arrange([item])
    assert {mark.name for mark in item.iter_markers()} & {*schedule.TIERS} == tiers


def test_what_is_apart_shares_nothing() -> None:
    """A fixture for a whole file would be made anew on each worker, and for a whole folder, too."""
    for place in schedule.APART:
        path = TESTS / place
        for file in path.glob("*.py") if path.is_dir() else [path]:
            assert 'scope="' not in file.read_text(), file
