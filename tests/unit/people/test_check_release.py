"""`check`: a service that runs another release than the one installed, and a Python that an upgrade would take away."""

from pathlib import Path

import pytest

from gateway.onboard.check import release
from gateway.onboard.check.result import Verdict


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


@pytest.mark.parametrize(
    ("links_to", "upgraded", "sentence"),
    [
        ("usr-bin/python3.11", False, None),
        ("usr-bin/python3", False, "an upgrade of the system makes it another"),
        ("usr-bin/python3.11", True, "the system's python3 is another one now"),
        ("own/python3.12", False, None),
        (None, False, None),
    ],
    ids=["the exact one", "a link that an upgrade changes", "after an upgrade", "named with PYTHON=", "not installed"],
)
def test_a_python_that_an_upgrade_of_the_system_takes_away(
    tmp_path: Path, links_to: str | None, upgraded: bool, sentence: str | None
) -> None:
    for name in ("usr-bin/python3.11", "usr-bin/python3.13", "own/python3.12"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    system = tmp_path / "usr-bin" / "python3"
    system.symlink_to("python3.13" if upgraded else "python3.11")
    if links_to is not None:  # as `python -m venv` makes it
        binaries = tmp_path / "venv-1" / "bin"
        binaries.mkdir(parents=True)
        target = tmp_path / links_to
        (binaries / target.name).symlink_to(target)
        (binaries / "python").symlink_to(target.name)
        (tmp_path / "venv").symlink_to("venv-1")
    found = release.interpreter(installed=tmp_path / "venv", system=system)
    assert (found is None) is (sentence is None)
    if found is not None and sentence is not None:
        assert sentence in found.sentence
        assert str(system.resolve()) in found.sentence + found.fix
