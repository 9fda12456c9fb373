"""What `check` says of a power board: its interface, what it answers, and its errors."""

import os
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from gateway.model.power_board import OVERTEMPERATURE, SERVO_OVERCURRENT
from gateway.onboard.check import power
from gateway.onboard.check.result import Result, Verdict
from gateway.robot.sections import PowerSettings
from tests.support.slcan_adapter import Adapter

CAN, ETHERNET = 280, 1


@pytest.fixture
def channel(tmp_path: Path) -> str:
    return str(tmp_path / "adapter")


@pytest.fixture
def adapter(channel: str) -> Iterator[Adapter]:
    made = Adapter(channel)
    yield made
    made.unplug()


def found(settings: PowerSettings, root: Path = Path("/"), *, gateway_runs: bool = False) -> list[Result]:
    return list(power.results(settings, gateway_runs=gateway_runs, root=root))


def on(channel: str, *, gateway_runs: bool = False) -> list[Result]:
    return found(PowerSettings(interface="slcan", channel=channel), gateway_runs=gateway_runs)


def test_without_a_board_not_a_word() -> None:
    assert found(PowerSettings()) == []


def test_a_simulated_one_takes_no_supply() -> None:
    (result,) = found(PowerSettings(interface="sim"))
    assert result.verdict is Verdict.WARNING


def test_a_board_that_answers(adapter: Adapter, channel: str) -> None:
    adapter.board.battery_mv = 15_200
    (result,) = on(channel)
    assert result.verdict is Verdict.OK
    assert result.sentence == (
        f"answers on slcan {channel}: supply 15.2 V; the servos' converters 7.4, 7.4, 7.4 V; 30 °C at most"
    )
    assert all(not line.startswith((b"t06A", b"t096")) for line in adapter.received), "it only asks"


def test_its_errors_are_named_with_their_servos(adapter: Adapter, channel: str) -> None:
    adapter.board.fail(SERVO_OVERCURRENT, 0b101)
    adapter.board.fail(OVERTEMPERATURE, 1)
    _, *errors = on(channel)
    assert {result.verdict for result in errors} == {Verdict.WARNING}
    sentences = " ".join(result.sentence for result in errors)
    assert "overcurrent" in sentences
    assert "no supply for 11, 13" in sentences
    assert "overtemperature: the power board has switched off its converter 1" in sentences


def test_a_board_that_is_silent(adapter: Adapter, channel: str) -> None:
    adapter.silent = True
    (result,) = on(channel)
    assert (result.verdict, "does not answer" in result.sentence) == (Verdict.FAILURE, True)
    assert "button" in result.fix


def test_a_running_gateway_is_not_disturbed(adapter: Adapter, channel: str) -> None:
    (result,) = on(channel, gateway_runs=True)
    assert result.verdict is Verdict.OK
    assert adapter.received == []


def test_an_adapter_that_is_not_there(tmp_path: Path) -> None:
    (result,) = on(str(tmp_path / "none"))
    assert (result.verdict, "does not exist" in result.sentence) == (Verdict.FAILURE, True)


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


@pytest.mark.parametrize(
    ("kind", "flags", "sentence"),
    [
        (None, 0, "there is no network interface can7"),
        (ETHERNET, 1, "can7 is no CAN interface"),
        (CAN, 0x40080, "can7 is switched off"),
        (CAN, 0x40081, "cannot be opened"),
    ],
)
def test_a_network_interface(tmp_path: Path, kind: int | None, flags: int, sentence: str) -> None:
    if kind is not None:
        folder = tmp_path / "sys/class/net/can7"
        folder.mkdir(parents=True)
        (folder / "type").write_text(f"{kind}\n")
        (folder / "flags").write_text(f"{flags:#x}\n")
    (result,) = found(PowerSettings(interface="socketcan", channel="can7"), tmp_path)
    assert (result.verdict, sentence in result.sentence) == (Verdict.FAILURE, True), result
    assert "switched off" not in sentence or "bitrate 1000000" in result.fix
