"""What a robot measures: the payload of `hexapod/telemetry`."""

from typing import Annotated

from pydantic import AwareDatetime, Field

from schemas.report import Report, Six, Sparse


class Battery(Report):
    """The robot's battery, as the controller measures it, else the power board."""

    voltage_v: Annotated[float, Field(description="as measured")]
    percent: Annotated[float | None, Field(description="as the controller sends it; null: by the power board")]


class Imu(Report):
    """The body's inertial sensor: orientation, angular velocity and acceleration."""

    orientation_wxyz: Annotated[tuple[float, float, float, float], Field(description="of the body, not normalised")]
    angular_velocity_rad_s: Annotated[tuple[float, float, float], Field(description="x, y, z in the sensor's frame")]
    linear_acceleration_m_s2: Annotated[tuple[float, float, float], Field(description="x, y, z, with gravity")]


class ServoTelemetry(Sparse):
    """What a power board measures of one servo."""

    supplied: Annotated[bool, Field(description="whether the power board feeds it")]
    current_a: Annotated[float | None, Field(description="its current")] = None


class Supply(Report):
    """What feeds the servos."""

    voltage_v: Annotated[float, Field(description="of the servos")]
    current_a: Annotated[float, Field(description="of all servos")]


class Telemetry(Sparse):
    """The payload of `hexapod/telemetry`: what the robot measures. Missing measurements are left out."""

    time: Annotated[AwareDatetime, Field(description="when it was published")]
    age_ms: Annotated[float, Field(ge=0, description="of the oldest of these values")]
    temperature_c: Annotated[float | None, Field(description="the controller's")] = None
    battery: Battery | None = None
    imu: Imu | None = None
    tilt_deg: Annotated[float | None, Field(description="of the body, 0 to 180, if the orientation is valid")] = None
    feet: Annotated[Six[float] | None, Field(description="forces, unit unknown")] = None
    servos: Annotated[dict[str, ServoTelemetry] | None, Field(description="by id, from the power board")] = None
    supply: Supply | None = None
    converters_v: Annotated[tuple[float, ...] | None, Field(description="the power board's converters")] = None
    board_temperatures_c: Annotated[tuple[float, ...] | None, Field(description="the power board's sensors")] = None
