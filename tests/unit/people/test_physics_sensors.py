"""What the sensors of the simulated body feel: as it stands, on a slope, while it falls, on its back."""

import math
from collections.abc import Iterator

import pytest

from gateway.geometry import load
from gateway.geometry.kinematics import about
from gateway.host.sensed_page import Sensed, SensedPage
from gateway.model import elkapod
from gateway.model.elkapod import Measured
from gateway.people.physics.assumed import MASS_KG, Assumed, Terrain
from gateway.people.physics.sensors import Sensors
from gateway.people.physics.world import World
from gateway.people.walking import Engine, Robot
from gateway.robot.spi.elkapod_simulator import SimulatedElkapod
from schemas.robot import SERVO_IDS
from tests.walking.physics import run, stand_up

GEOMETRY = load()
G = 9.81
WEIGHT_N = MASS_KG * G


def standing(terrain: str = "flat") -> tuple[World, Sensors]:
    world = World(GEOMETRY, Assumed(terrain=Terrain.parsed(terrain)))
    stand_up(world, Engine(Robot(GEOMETRY)), GEOMETRY)
    sensors = Sensors(world)
    run(world, 0.1)
    return world, sensors


def on_the_wire(sensed: Sensed) -> Measured:
    """What a controller with this body answers: its bytes, read again."""
    page = SensedPage()
    page.write(sensed)
    controller = SimulatedElkapod(clock=lambda: 0, sensed=page)
    controller.exchange(bytes(elkapod.FRAME_BYTES))
    return elkapod.measured(controller.exchange(bytes(elkapod.FRAME_BYTES)))


def test_standing_still_it_feels_its_weight_and_no_more() -> None:
    _, sensors = standing()
    sensed = sensors.read()
    assert sensed.linear_acceleration_m_s2 == pytest.approx((0, 0, G), abs=0.05)
    assert sensed.angular_velocity_rad_s == pytest.approx((0, 0, 0), abs=0.01)
    assert sum(sensed.feet_n) == pytest.approx(WEIGHT_N, rel=0.02)
    assert all(0.1 * WEIGHT_N < foot_n < 0.3 * WEIGHT_N for foot_n in sensed.feet_n)
    answered = on_the_wire(sensed)
    assert answered.tilt_deg == pytest.approx(0, abs=1)
    assert answered.linear_acceleration_m_s2 == pytest.approx((0, 0, G), abs=0.15)
    assert sum(answered.feet) == pytest.approx(WEIGHT_N, rel=0.02)


@pytest.mark.parametrize("slope_deg", [12, -12])
def test_on_a_slope_it_feels_how_steep_it_is_and_which_way(slope_deg: int) -> None:
    """Uphill lies ahead, so the ground pushes it forward; downhill, backward."""
    _, sensors = standing(f"slope:{slope_deg}")
    sensed = sensors.read()
    assert on_the_wire(sensed).tilt_deg == pytest.approx(12, abs=1)
    slope_rad = math.radians(slope_deg)
    assert sensed.linear_acceleration_m_s2 == pytest.approx(
        (G * math.sin(slope_rad), 0, G * math.cos(slope_rad)), abs=0.3
    )
    assert sum(sensed.feet_n) == pytest.approx(WEIGHT_N * math.cos(slope_rad), rel=0.03)


def test_tipped_over_it_feels_that_it_lies_on_its_back() -> None:
    world = World(GEOMETRY)
    x, y, z, w = about((1, 0, 0), math.pi)
    world.data.qpos[:7] = 0.0, 0.0, 0.15, w, x, y, z
    sensors = Sensors(world)
    run(world, 1.0)
    sensors.read()
    run(world, 0.1)
    sensed = sensors.read()
    tilt_deg = on_the_wire(sensed).tilt_deg
    assert tilt_deg is not None
    assert tilt_deg > 150
    assert sensed.linear_acceleration_m_s2[2] < -0.9 * G


def tipping(world: World, sensors: Sensors) -> Iterator[Sensed]:
    """In the air, turning about its x axis by three radians a second."""
    world.data.qpos[2] = 2.0
    world.data.qvel[:6] = 0, 0, 0, 3.0, 0, 0
    sensors.read()
    for _ in range(10):
        run(world, 0.02)
        yield sensors.read()


def test_in_the_air_it_feels_how_fast_it_turns_and_no_weight() -> None:
    world = World(GEOMETRY)
    sensors = Sensors(world)
    felt = list(tipping(world, sensors))
    assert felt[-1].angular_velocity_rad_s[0] == pytest.approx(3.0, abs=0.7)
    assert felt[-1].feet_n == (0,) * 6
    assert math.hypot(*felt[-1].linear_acceleration_m_s2) < 0.3 * G
    tilts_deg = [on_the_wire(each).tilt_deg or 0.0 for each in felt]
    assert tilts_deg == sorted(tilts_deg)
    assert tilts_deg[-1] == pytest.approx(math.degrees(3.0 * 0.2), rel=0.2)


def test_between_two_steps_it_feels_what_it_felt() -> None:
    world = World(GEOMETRY)
    sensors = Sensors(world)
    assert sensors.read().linear_acceleration_m_s2 == pytest.approx((0, 0, G))
    run(world, 0.02)
    assert sensors.read() == sensors.read()


def test_a_servo_that_carries_has_its_torque_and_a_slack_one_none() -> None:
    world, sensors = standing()
    assert sum(map(abs, sensors.read().torques_nm)) > 1
    for servo_id in SERVO_IDS:
        world.drive(servo_id, None)
    run(world, 0.02)
    assert sensors.read().torques_nm == (0,) * len(SERVO_IDS)


def test_who_carries_more_finds_its_battery_lower() -> None:
    _, sensors = standing()
    held = sensors.read()
    slack = held._replace(torques_nm=(0.0,) * len(SERVO_IDS))
    assert on_the_wire(held).voltage_v < on_the_wire(slack).voltage_v - 0.05
