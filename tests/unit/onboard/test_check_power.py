"""What `check` says of a power board: its interface, and what it answers."""

import os
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from gateway.onboard.check import wire
from gateway.onboard.check.table import CheckedRobot, Result, Verdict, results
from gateway.robot.settings import Settings
from tests.support.slcan_adapter import Adapter


@pytest.fixture
def channel(tmp_path: Path) -> str:
    return str(tmp_path / "adapter")


@pytest.fixture
def adapter(channel: str) -> Iterator[Adapter]:
    made = Adapter(channel)
    yield made
    made.unplug()


def on(channel: str, *, gateway_runs: bool = False) -> list[Result]:
    settings = Settings.model_validate({"power": {"interface": "slcan", "channel": channel}})
    return list(results([wire.POWER[0]], CheckedRobot(settings, gateway_runs=gateway_runs)))


def test_a_board_that_answers(adapter: Adapter, channel: str) -> None:
    adapter.board.battery_mv = 15_200
    (result,) = on(channel)
    assert result.verdict is Verdict.OK
    assert result.sentence == (
        f"answers on slcan {channel}: supply 15.2 V; the servos' converters 7.4, 7.4, 7.4 V; 30 °C at most"
    )
    assert all(not line.startswith((b"t06A", b"t096")) for line in adapter.received), "it only asks"


def test_a_board_that_is_silent(adapter: Adapter, channel: str) -> None:
    adapter.silent = True
    (result,) = on(channel)
    assert (result.verdict, "does not answer" in result.sentence) == (Verdict.FAILURE, True)
    assert "button" in result.fix


def test_a_running_gateway_is_not_disturbed(adapter: Adapter, channel: str) -> None:
    (result,) = on(channel, gateway_runs=True)
    assert result.verdict is Verdict.OK
    assert adapter.received == []


def test_one_that_this_user_may_not_open(adapter: Adapter, channel: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "access", lambda *_: False)
    (result,) = on(channel)
    assert (result.verdict, "may not be opened" in result.sentence) == (Verdict.FAILURE, True)
    assert adapter.received == []


def test_without_python_can(adapter: Adapter, channel: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "can", None)
    (result,) = on(channel)
    assert (result.verdict, "python-can is not installed" in result.sentence) == (Verdict.FAILURE, True)
    assert adapter.received == []
