"""What a robot measures, as the payload of `hexapod/telemetry`: pure."""

from datetime import datetime

from gateway.model.elkapod import Measured
from schemas.telemetry import Battery, Imu, Telemetry


def telemetry_of(values: Measured, time: datetime, age_ms: float) -> Telemetry:
    """The payload; `age_ms` old at `time`."""
    return Telemetry(
        time=time,
        age_ms=age_ms,
        temperature_c=values.temperature_c,
        battery=battery_of(values),
        imu=Imu(
            orientation_wxyz=values.orientation_wxyz,
            angular_velocity_rad_s=values.angular_velocity_rad_s,
            linear_acceleration_m_s2=values.linear_acceleration_m_s2,
        ),
        tilt_deg=values.tilt_deg,
        feet=values.feet,
    )


def battery_of(values: Measured) -> Battery:
    """The battery, as the robot tells it."""
    return Battery(voltage_v=values.voltage_v, percent=values.percent)
