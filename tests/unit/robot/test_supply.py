"""The supply as the service makes it: its line is begun, and its news reach the owner of the state on the loop."""

import asyncio
import time
from pathlib import Path

from gateway.robot import wires
from gateway.robot.host.ownership import Ownership
from gateway.robot.runtime.supply import supply_of
from gateway.robot.settings import Settings
from tests.support.slcan_adapter import Adapter

_PARTS = wires.SimulatedParts(controller=True)


async def test_without_an_interface_there_is_no_supply() -> None:
    settings = Settings()
    wire = wires.wire(settings, _PARTS)
    assert supply_of(settings, wire, None, asyncio.get_running_loop(), Ownership(), failed) is None


async def test_the_first_mask_switches_all_off_and_news_come_on_the_loop_with_the_state(tmp_path: Path) -> None:
    channel = str(tmp_path / "can")
    adapter = Adapter(channel)
    settings = Settings.of({"power": {"interface": "sim", "confirm_ms": 2000}})
    owner, heard = Ownership(), asyncio.Event()
    supply = supply_of(
        settings,
        wires.wire(settings, _PARTS),
        channel,
        asyncio.get_running_loop(),
        owner,
        failed,
    )
    assert supply is not None

    def news() -> None:
        assert owner._state.locked()
        supply.take_news()
        if supply.report(0).confirmed:
            heard.set()

    supply.on_news = news
    await asyncio.wait_for(heard.wait(), 10)
    report = supply.report(0)
    assert (report.interface, report.alive, report.supplied) == ("sim", True, ())
    masks = [line for line in adapter.received if line.startswith(b"t06A")]
    assert set(masks) == {b"t06A3000000"}
    told: asyncio.Future[bool] = asyncio.get_running_loop().create_future()
    supply.confirm(frozenset({11}), time.monotonic_ns(), lambda ms: told.set_result(ms is not None))
    assert await asyncio.wait_for(told, 10), "within confirm_ms"
    await asyncio.to_thread(supply.line.close)
    asked = len(adapter.received)
    await asyncio.sleep(0.1)
    assert len(adapter.received) - asked <= 1, "the line is closed"
    adapter.unplug()


def failed(error: Exception) -> None:
    raise AssertionError(error)
