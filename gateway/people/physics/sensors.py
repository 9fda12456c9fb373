"""What the sensors of the simulated body feel: an IMU in its middle, a force in each foot, each servo's torque."""

from typing import Any

from gateway.geometry.kinematics import rotated
from gateway.host.sensed_page import Sensed
from gateway.people.physics.world import World, vector


class Sensors:
    """Of this body; to be read again and again."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._time_s = world.time_s
        self._velocity_m_s: Any = world.data.qvel[:3].copy()
        self._felt_m_s2: Any = -world.model.opt.gravity
        """Acceleration in the world's frame; a body at rest is held up against gravity."""

    def read(self) -> Sensed:
        """What they feel now. The acceleration is the mean since the last call, as an IMU's filter has it."""
        world, data = self._world, self._world.data
        passed_s = world.time_s - self._time_s
        if passed_s > 0:
            velocity_m_s = data.qvel[:3].copy()
            self._felt_m_s2 = (velocity_m_s - self._velocity_m_s) / passed_s - world.model.opt.gravity
            self._time_s, self._velocity_m_s = world.time_s, velocity_m_s
        w, x, y, z = map(float, data.qpos[3:7])
        return Sensed(
            orientation_wxyz=(w, x, y, z),
            angular_velocity_rad_s=vector(data.qvel[3:6]),
            linear_acceleration_m_s2=rotated((-x, -y, -z, w), vector(self._felt_m_s2)),
            feet_n=world.feet_n(),
            torques_nm=tuple(map(float, data.actuator_force)),
        )
