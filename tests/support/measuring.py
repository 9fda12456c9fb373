"""What a robot that measures publishes, for tests of what people and programs make of it."""

import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Final

import zenoh
from pydantic import BaseModel

from gateway.client import Client
from schemas import keys
from schemas.state import Payloads
from schemas.telemetry import Battery, GatewayState, Imu, Telemetry
from tests.support.published import WALL, state
from tests.support.router import zenoh_listening

MEASURED: Final = Telemetry(
    time=WALL,
    age_ms=12.5,
    temperature_c=31.5,
    battery=Battery(voltage_v=7.4, percent=80.0),
    imu=Imu(
        orientation_wxyz=(1.0, 0.0, 0.0, 0.0),
        angular_velocity_rad_s=(0.0, 0.0, 0.5),
        linear_acceleration_m_s2=(0.0, 0.0, 9.81),
    ),
    tilt_deg=0.0,
    feet=(1.0, 2.0, 3.0, 4.0, 5.0, 6.0),
)
"""Of an Elkapod that turns on the spot."""
LEANING: Final = MEASURED.model_copy(
    update={
        "imu": Imu(
            orientation_wxyz=(0.9914, 0.1305, 0.0, 0.0),
            angular_velocity_rad_s=(0.0, 0.0, 0.0),
            linear_acceleration_m_s2=(0.0, 0.0, 9.81),
        ),
        "tilt_deg": 15.0,
        "feet": (9.0, 0.0, 0.1, 11.0, 8.0, -0.2),
    }
)
"""It leans by 15° to the right, on feet 1, 4 and 5."""
_PERIOD_S: Final = 0.1


@contextmanager
def measures(client: Client, telemetry: Telemetry) -> Iterator[None]:
    """A robot that measures this, ten times a second."""
    ended = threading.Event()

    def publish() -> None:
        while not ended.wait(_PERIOD_S):
            client.session.put(keys.TELEMETRY, telemetry.model_dump_json())

    thread = threading.Thread(target=publish)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


class Measuring:
    """A session in a gateway's place: it answers with a state, and with what it measures once that is there."""

    def __init__(self, session: zenoh.Session) -> None:
        self._session = session
        self.measured: Telemetry | None = None
        self.state: GatewayState = state()
        self._declared: Any = (
            session.declare_queryable(
                keys.STATE, lambda query: self._reply(query, keys.STATE, Payloads().of(self.state)[0])
            ),
            session.declare_queryable(
                keys.CONFIG, lambda query: self._reply(query, keys.CONFIG, Payloads().of(self.state)[1])
            ),
            session.declare_queryable(keys.TELEMETRY, lambda query: self._reply(query, keys.TELEMETRY, self.measured)),
        )

    def publish(self, measured: Telemetry) -> None:
        """As the gateway does ten times a second."""
        self.measured = measured
        self._session.put(keys.TELEMETRY, measured.model_dump_json())

    def publish_rubbish(self) -> None:
        """What no gateway publishes."""
        self._session.put(keys.TELEMETRY, json.dumps({"battery": "full"}))

    def _reply(self, query: zenoh.Query, key: str, report: BaseModel | None) -> None:
        with query:
            if report is not None:
                query.reply(key, report.model_dump_json())


@contextmanager
def measuring(endpoint: str) -> Iterator[Measuring]:
    """Listens there, in this process."""
    with zenoh_listening(endpoint) as session:
        yield Measuring(session)
