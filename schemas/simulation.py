"""The body of a simulated robot: the payload of `hexapod/sim/body`."""

from typing import Annotated

from pydantic import AwareDatetime, Field

from schemas.report import Report, Six


class SimulatedServo(Report):
    """Angle of a simulated servo, as in commands, and its torque against the load."""

    angle_deg: Annotated[float, Field(description="its angle, as in commands")]
    torque_nm: Annotated[float, Field(description="against its load; 0: off")]


class BodyReport(Report):
    """The payload of `hexapod/sim/body`: the pose of a simulated robot, 30 times a second.

    In the ground's frame: x forward and y left at the start, z up. `feet`: which of legs 1 to 6 touch the ground.
    """

    time: Annotated[AwareDatetime, Field(description="when")]
    position_m: Annotated[tuple[float, float, float], Field(description="of the body's frame")]
    orientation_xyzw: Annotated[tuple[float, float, float, float], Field(description="unit quaternion, body to ground")]
    velocity_m_s: Annotated[tuple[float, float, float], Field(description="of the body")]
    upright: Annotated[bool, Field(description="leans by less than 45°")]
    feet: Annotated[Six[bool], Field(description="of legs 1 to 6: on the ground")]
    servos: Annotated[dict[str, SimulatedServo], Field(description="by id")]
    terrain: Annotated[str, Field(description="as `run --terrain` names it")] = "flat"
    real_time_factor: Annotated[float, Field(ge=0, description="below 1 the machine is too slow")] = 1.0
