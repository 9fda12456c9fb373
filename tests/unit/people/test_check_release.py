"""`check`: a service that runs another release than the one installed, and a Python that an upgrade would take away."""

import os
from pathlib import Path

import pytest

from gateway.people.tools.check import release
from gateway.people.tools.check.result import Verdict


@pytest.mark.parametrize(
    ("maps", "folder"),
    [
        ("7f0-7f1 r-xp 0 fe:00 9 /opt/hexapod-gateway/venv-0a1b/lib/python3.11/x.so\n", "venv-0a1b"),
        ("7f0-7f1 r-xp 0 fe:00 9 /opt/hexapod-gateway/venv-0a1b-2/lib/x.so (deleted)\n", "venv-0a1b-2"),
        ("7f0-7f1 r-xp 0 fe:00 9 /usr/lib/libc.so.6\n", None),
    ],
)
def test_what_a_process_has_loaded(tmp_path: Path, maps: str, folder: str | None) -> None:
    (tmp_path / "7").mkdir()
    (tmp_path / "7/maps").write_text(maps)
    found = release.running(7, proc=tmp_path)
    assert found == (None if folder is None else Path("/opt/hexapod-gateway") / folder)
    assert release.running(8, proc=tmp_path) is None


def test_another_release_than_the_one_installed(tmp_path: Path) -> None:
    link, old, new = tmp_path / "venv", tmp_path / "venv-old", tmp_path / "venv-new"
    for folder in (old, new):
        folder.mkdir()
    link.symlink_to(new)
    assert release.release(new, installed=link) is None
    assert release.release(None, installed=link) is None
    found = release.release(old, installed=link)
    assert found is not None
    assert found.verdict is Verdict.WARNING
    assert f"{old}, not {new}" in found.sentence


@pytest.fixture
def system(tmp_path: Path) -> Path:
    """/usr/bin: python3 is a link to python3.11."""
    folder = tmp_path / "usr-bin"
    folder.mkdir()
    (folder / "python3.11").write_text("")
    (folder / "python3").symlink_to("python3.11")
    return folder


def installed(tmp_path: Path, target: Path) -> Path:
    """A link to a release whose Python is a link to `target`, as `python -m venv` makes it."""
    binaries = tmp_path / "venv-1/bin"
    binaries.mkdir(parents=True)
    (binaries / target.name).symlink_to(target)
    if target.name != "python":
        (binaries / "python").symlink_to(target.name)
    (tmp_path / "venv").symlink_to("venv-1")
    return tmp_path / "venv"


def test_the_exact_interpreter_needs_nothing(tmp_path: Path, system: Path) -> None:
    venv = installed(tmp_path, system / "python3.11")
    assert release.interpreter(installed=venv, system=system / "python3") is None


def test_a_link_that_an_upgrade_changes(tmp_path: Path, system: Path) -> None:
    found = release.interpreter(installed=installed(tmp_path, system / "python3"), system=system / "python3")
    assert found is not None
    assert "an upgrade of the system makes it another" in found.sentence
    assert str(system / "python3.11") in found.fix


def test_a_system_that_was_upgraded(tmp_path: Path, system: Path) -> None:
    venv = installed(tmp_path, system / "python3.11")
    (system / "python3.13").write_text("")
    os.remove(system / "python3")
    (system / "python3").symlink_to("python3.13")
    found = release.interpreter(installed=venv, system=system / "python3")
    assert found is not None
    assert "the system's python3 is another one now" in found.sentence


def test_a_python_of_ones_own(tmp_path: Path, system: Path) -> None:
    """Named with PYTHON=: the system's upgrades do not concern it."""
    own = tmp_path / "own"
    own.mkdir()
    (own / "python3.12").write_text("")
    assert release.interpreter(installed=installed(tmp_path, own / "python3.12"), system=system / "python3") is None


def test_no_installation_here(tmp_path: Path, system: Path) -> None:
    assert release.interpreter(installed=tmp_path / "venv", system=system / "python3") is None
