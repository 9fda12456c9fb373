"""Reports of the robot's measurements, for `hexapod/telemetry` and incidents. Values are not rounded."""

from datetime import datetime

from gateway.model.elkapod import Measured
from schemas.telemetry import Battery, Imu, Telemetry


def report_of(values: Measured, time: datetime, age_ms: float) -> Telemetry:
    """Return the telemetry of these values, which were `age_ms` old at `time`."""
    named = values._asdict()  # by the names of the report
    battery, imu = Battery.model_validate(named), Imu.model_validate(named)
    return Telemetry(time=time, age_ms=age_ms, battery=battery, imu=imu, tilt_deg=values.tilt_deg, **named)
