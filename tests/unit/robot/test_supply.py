"""The supply as the service makes it: its line is begun, and its news reach the owner of the state on the loop."""

import asyncio
from pathlib import Path

import pytest

from gateway.host.settings_table import PowerSettings
from gateway.robot.power.line import PowerLine
from tests.support.robot import Robot
from tests.support.slcan_adapter import Adapter


async def test_the_first_mask_switches_all_off_and_news_come_on_the_loop_with_the_state(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    channel = str(tmp_path / "can")
    adapter = Adapter(channel)
    mistakes: list[Exception] = []
    line = PowerLine(PowerSettings("slcan", channel, confirm_ms=2000), mistakes.append)
    monkeypatch.setattr(Robot, "power_line", lambda _: line)
    conductor = Robot({"power": {"interface": "sim"}}).conductor
    confirmed = asyncio.Event()
    publish = conductor.reports.publish

    def published() -> None:
        assert conductor.owner._state.locked()
        publish()
        if line.status.confirmed:
            confirmed.set()

    monkeypatch.setattr(conductor.reports, "publish", published)
    conductor.start()
    line.start()
    await asyncio.wait_for(confirmed.wait(), 10)
    report = conductor.reports.power()
    assert report is not None
    assert (report.interface, report.alive, report.supplied) == ("sim", True, ())
    masks = [each for each in adapter.received if each.startswith(b"t06A")]
    assert set(masks) == {b"t06A3000000"}
    await asyncio.to_thread(line.close, 10)
    assert not line._sender.is_alive()
    assert not line._receiver.is_alive()
    assert mistakes == []
    adapter.unplug()
