"""What a robot that measures publishes, for tests of what people and programs make of it."""

from contextlib import AbstractContextManager
from typing import Final

from gateway.client import Client
from gateway.model.elkapod import Measured
from schemas import keys
from schemas.telemetry import Battery, Imu, Telemetry
from tests.support.published import WALL
from tests.support.waiting import meanwhile

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


def measures(client: Client, telemetry: Telemetry) -> AbstractContextManager[None]:
    """Return a robot that measures this, ten times a second."""
    return meanwhile(lambda: client.session.put(keys.TELEMETRY, telemetry.model_dump_json()), _PERIOD_S)


AT_REST: Final = Measured(
    temperature_c=31.5,
    voltage_v=7.5,
    percent=80.0,
    orientation_wxyz=(1.0, 0.0, 0.0, 0.0),
    angular_velocity_rad_s=(0.0, 0.25, 0.0),
    linear_acceleration_m_s2=(0.0, 0.0, 9.75),
    feet=(1.0, 2.0, 3.0, 4.0, 5.0, 6.0),
)
ON_ITS_SIDE: Final = AT_REST._replace(orientation_wxyz=(0.75, 0.65625, 0.0, 0.0))
"""Tilted by some 82 degrees."""
