"""What a robot measures, over a real Zenoh: published while somebody listens, and answered."""

import asyncio
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, closing
from typing import Any

import zenoh
from zenoh.handlers import RingChannel

from gateway.robot.blackbox.recorder import Recorder
from gateway.robot.core.supervisor import Supervisor
from gateway.robot.runtime.calibrations import Calibrations
from gateway.robot.runtime.conductor import Conductor
from gateway.robot.runtime.revocations import Revocations
from gateway.robot.service import _inbox, _report_tasks, rules
from gateway.robot.settings import Settings
from gateway.robot.spi.bus import Bus
from gateway.robot.spi.simulator import SimulatedController
from gateway.robot.zenoh_io.outbox import ZenohOutbox
from gateway.robot.zenoh_io.session import service_config
from gateway.zenoh_config import client_config, open_session
from schemas.keys import CALIBRATION, TELEMETRY
from schemas.telemetry import Telemetry
from tests.support.gateway_process import free_port
from tests.support.measured import MEASURED, ON_ITS_SIDE


@asynccontextmanager
async def served(**sections: Any) -> AsyncIterator[tuple[Conductor, zenoh.Session]]:
    """The service's parts between its conductor and Zenoh, and a laptop that is connected with them."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    settings = Settings.model_validate({"zenoh": {"listen": [endpoint]}, **sections})
    loop, outbox = asyncio.get_running_loop(), ZenohOutbox()
    controller = SimulatedController(settings.spi.framing)
    conductor = Conductor(
        settings,
        Supervisor(rules(settings)),
        Bus(settings.spi, lambda: controller),
        outbox,
        loop,
        clock=time.monotonic_ns,
        simulated=True,
        recorder=Recorder(settings, {}, time.monotonic_ns, time.time_ns),
    )
    with closing(open_session(service_config(settings.zenoh))) as session:
        outbox.open(session)
        with conductor.owner:
            conductor.start()
            calibrations, revocations = (
                Calibrations(conductor, None, loop),
                Revocations(conductor, None, loop, lambda: None),
            )
            inbox = _inbox(session, loop, conductor, None, settings, calibrations, revocations)
        tasks = _report_tasks(settings, conductor, outbox)
        try:
            with closing(open_session(client_config(endpoint))) as laptop:
                yield conductor, laptop
        finally:
            for task in tasks:
                task.cancel()
            with conductor.owner:
                conductor.close()
            inbox.close()
            outbox.close()


def answers(laptop: zenoh.Session, key: str) -> list[bytes]:
    """Ends when the gateway has let go of the question."""
    return [answer.ok.payload.to_bytes() for answer in laptop.get(key, timeout=10) if answer.ok]


async def test_what_is_measured_is_published_while_somebody_listens_and_answered() -> None:
    async with served(spi={"protocol": "elkapod-2025"}) as (conductor, laptop):
        assert await asyncio.to_thread(answers, laptop, TELEMETRY) == [], "nothing was measured yet"
        assert len(await asyncio.to_thread(answers, laptop, CALIBRATION)) == 1
        with closing(Watching(laptop)) as watching:
            for values, tilt_deg in ((MEASURED, 0.0), (ON_ITS_SIDE, ON_ITS_SIDE.tilt_deg)):
                with conductor.owner:
                    conductor.measured(values, time.monotonic_ns())
                (answer,) = await asyncio.to_thread(answers, laptop, TELEMETRY)
                report = Telemetry.model_validate_json(answer)
                assert (report.tilt_deg, report.feet) == (tilt_deg, values.feet)
                assert await asyncio.wait_for(asyncio.to_thread(watching.has_tilt, tilt_deg), 10)


class Watching:
    """Reads what is published until it has what it waits for."""

    def __init__(self, laptop: zenoh.Session) -> None:
        self._subscriber = laptop.declare_subscriber(TELEMETRY, RingChannel(1))

    def has_tilt(self, tilt_deg: float | None) -> bool:
        while Telemetry.model_validate_json(self._subscriber.handler.recv().payload.to_bytes()).tilt_deg != tilt_deg:
            pass
        return True

    def close(self) -> None:
        self._subscriber.undeclare()
