"""A plug-in (`gateway.wire`) that does what no wire should: a Stop, and a rule, never depend on its author's care."""

import asyncio
import importlib.metadata
import os
import sys
from collections.abc import Sequence
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import ClassVar

import pytest

from gateway.errors import ConfigError, SpiError
from gateway.host.descriptors import SPARES, Spare
from gateway.host.settings_table import WireSettings
from gateway.model.frames import stop_leg
from gateway.robot.settings import Settings
from gateway.robot.spi import Wire
from gateway.robot.spi.plugin import plugin_bus
from gateway.wire import GROUP, ServoWire
from schemas import keys
from tests.support.robot import Robot, leg


class Exits(ServoWire):
    """Ends the process in place of raising."""

    stopped: ClassVar[set[int]] = set()
    error: ClassVar[BaseException] = SystemExit(2)

    def open(self) -> None:
        self.stopped.clear()

    def apply(self, changes: Sequence[tuple[int, float | None]]) -> None:
        for servo, _ in changes:
            if servo == 12:
                raise self.error
            self.stopped.add(servo)

    def close(self) -> None:
        pass


class Keeps(ServoWire):
    """Keeps its calls."""

    calls: ClassVar[list[dict[int, float | None]]] = []

    def open(self) -> None:
        self.calls.clear()

    def apply(self, changes: Sequence[tuple[int, float | None]]) -> None:
        self.calls.append(dict(changes))

    def close(self) -> None:
        pass


class Plugged(Robot):
    """A robot whose wire is a plug-in that keeps its calls; its service has begun."""

    def __init__(self) -> None:
        super().__init__({"wire": {"name": "keeps"}})
        self.conductor.start()

    def wire(self) -> Wire:
        return plugin_bus(self.settings.wire)


@pytest.fixture(autouse=True)
def installed(monkeypatch: pytest.MonkeyPatch) -> None:
    found = tuple(EntryPoint(each.lower(), f"{__name__}:{each}", GROUP) for each in ("Exits", "Keeps"))
    early = EntryPoint("early", "sys:exit", GROUP)
    monkeypatch.setattr(importlib.metadata, "entry_points", lambda **_: (*found, early))


@pytest.mark.virtual_time
async def test_a_stop_beside_moves_comes_first_in_a_call_of_its_own_and_the_answer_after_both() -> None:
    robot = Plugged()
    robot.put(keys.leg_command(1), leg("start", 90, 90, 90))
    await asyncio.sleep(0.1)
    Keeps.calls.clear()
    ops = {"servos": [{"op": "stop"}, *({"op": "set", "angle_deg": angle} for angle in (80, 70))]}
    assert robot.ask(keys.leg_command(1), ops).accepted
    assert Keeps.calls == [{11: None}, {12: 80, 13: 70}]
    assert [servo.running for servo in robot.state().legs[0].servos] == [False, True, True]


@pytest.mark.parametrize("error", [SystemExit(2), KeyboardInterrupt(2), GeneratorExit(2)], ids=type)
def test_a_plugin_that_calls_exit_is_a_bug_and_the_other_servos_are_stopped(
    monkeypatch: pytest.MonkeyPatch, error: BaseException
) -> None:
    monkeypatch.setattr(Exits, "error", error)
    bus = plugin_bus(WireSettings("exits", {}))
    bus.open()
    with pytest.raises(RuntimeError, match=f"exits: {type(error).__name__}: 2"):
        bus.write([stop_leg(1)])
    assert Exits.stopped == {11, 13}, "a mistake with one servo keeps no Stop from the others"


def test_a_plugin_that_cannot_be_opened_for_a_bug_gets_stops_all_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Exits, "stopped", set())
    monkeypatch.setattr(Exits, "open", lambda _self: sys.exit(2))
    with pytest.raises(RuntimeError, match="exits: SystemExit: 2"):
        plugin_bus(WireSettings("exits", {})).open()
    assert Exits.stopped == {11}, "up to the servo for which it exits"


def test_a_plugin_that_is_unplugged_is_a_fault_until_it_is_opened_again(monkeypatch: pytest.MonkeyPatch) -> None:
    bus = plugin_bus(WireSettings("exits", {}))
    bus.open()
    with monkeypatch.context() as unplugged:
        for method in ("open", "apply"):
            unplugged.setattr(Exits, method, lambda *_: os.stat("/nowhere"))
        assert str(bus.write([stop_leg(2)]).fault) == "exits: No such file or directory"
        with pytest.raises(SpiError, match="exits: No such file"):
            bus.open()
    bus.open()
    assert bus.write([stop_leg(2)]).fault is None
    assert Exits.stopped == {21, 22, 23}


def test_descriptors_of_a_closed_plugin_are_kept_for_it() -> None:
    """Else clients would take them, a few with each fault, until it could not be opened."""
    bus = plugin_bus(WireSettings("exits", {}), spare=(spare := Spare()))
    bus.open()
    assert spare.give_up()
    bus.close()
    assert len(spare._kept) == SPARES


def test_a_plugin_that_exits_where_it_is_made_is_a_sentence() -> None:
    with pytest.raises(ValueError, match=r'"early" .* cannot be loaded with these options: SystemExit'):
        _ = WireSettings("early", {}).plugin


def test_a_limit_on_what_a_plugin_cannot_hand_over_is_not_accepted() -> None:
    with pytest.raises(ConfigError, match=r"safety\.max_tilt_deg: exits has nothing that measures it"):
        Settings.of({"wire": {"name": "exits"}, "safety": {"max_tilt_deg": 45}})
    assert not Settings.of({"wire": {"name": "exits"}}).measures


def test_a_plugin_that_another_gateway_has_is_not_even_closed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """It was never opened here: on shared hardware its `close` could take the servos from the other gateway."""
    monkeypatch.setenv("RUNTIME_DIRECTORY", str(tmp_path))
    first, second, closed = (plugin_bus(WireSettings("exits", {})), plugin_bus(WireSettings("exits", {})), list[str]())
    first.open()
    monkeypatch.setattr(Exits, "close", lambda _self: closed.append("closed"))
    with pytest.raises(SpiError, match="another gateway has exits"):
        second.open()
    assert closed == []
    first.close()
    second.open()
    second.close()
    assert closed == ["closed", "closed"]
