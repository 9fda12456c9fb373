"""Reports of the robot's measurements, for `hexapod/telemetry` and incidents. Values are not rounded."""

from datetime import datetime

from gateway.model.elkapod import Measured
from schemas.telemetry import Battery, Imu, Telemetry


def battery_of(values: Measured) -> Battery:
    """Return the battery's report, in volts and in percent as the robot reports it."""
    return Battery(voltage_v=values.voltage_v, percent=values.percent)


def report_of(values: Measured, time: datetime, age_ms: float) -> Telemetry:
    """Return the telemetry of these values, which were `age_ms` old at `time`."""
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
