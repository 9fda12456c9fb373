"""What makes a test a unit test: it starts no process and opens no Zenoh session, so that all of them take seconds."""

import os
import subprocess
from pathlib import Path

import pytest
import zenoh

from gateway.robot import settings


@pytest.fixture(autouse=True)
def _alone(monkeypatch: pytest.MonkeyPatch) -> None:
    def reject(*_: object, **__: object) -> None:
        raise AssertionError("a unit test starts no process and opens no session; tests/zenoh is the place for that")

    monkeypatch.setattr(subprocess, "Popen", reject)
    monkeypatch.setattr(zenoh, "open", reject)


@pytest.fixture
def _clean_environment(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Remove this machine's variables and default file."""
    for name in list(os.environ):
        if name.upper().startswith("HEXAPOD"):
            monkeypatch.delenv(name)
    monkeypatch.setattr(settings, "CONFIGURATION", tmp_path / "default.toml")


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "gateway.toml"


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a black box's folder, with its ring in the same folder."""
    monkeypatch.setenv("RUNTIME_DIRECTORY", str(tmp_path))
    monkeypatch.delenv("STATE_DIRECTORY", raising=False)
    made = tmp_path / "state"
    made.mkdir()
    return made
