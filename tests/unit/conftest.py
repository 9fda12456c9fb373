"""What makes a test a unit test: it starts no process and opens no Zenoh session, so that all of them take seconds."""

import subprocess

import pytest
import zenoh


@pytest.fixture(autouse=True)
def _alone(monkeypatch: pytest.MonkeyPatch) -> None:
    def reject(*_: object, **__: object) -> None:
        raise AssertionError("a unit test starts no process and opens no session; tests/zenoh is the place for that")

    monkeypatch.setattr(subprocess, "Popen", reject)
    monkeypatch.setattr(zenoh, "open", reject)
