"""What a robot measures at rest; its values are float32."""

from typing import Final

from gateway.model.elkapod import Measured

MEASURED: Final = Measured(
    temperature_c=31.5,
    voltage_v=7.5,
    percent=80.0,
    orientation_wxyz=(1.0, 0.0, 0.0, 0.0),
    angular_velocity_rad_s=(0.0, 0.25, 0.0),
    linear_acceleration_m_s2=(0.0, 0.0, 9.75),
    feet=(1.0, 2.0, 3.0, 4.0, 5.0, 6.0),
)
ON_ITS_SIDE: Final = MEASURED._replace(orientation_wxyz=(0.75, 0.65625, 0.0, 0.0))
"""Tilted by some 82 degrees."""
