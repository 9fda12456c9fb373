"""The robot's body in MuJoCo: it stands, falls and lies as a thing of that weight does; and real time."""

import math

import pytest

from gateway.cli import run as run_command
from gateway.errors import ConfigError
from gateway.geometry import load
from gateway.geometry.kinematics import about, rotated
from gateway.geometry.model import TOTAL_KG
from gateway.host.shared_page import SensedPage
from gateway.model import elkapod
from gateway.model.calibration import RobotCalibration, ServoMapping
from gateway.people.physics.assumed import FRICTION, MASS_KG, TORQUE_NM, Assumed, Terrain, assumed
from gateway.people.physics.process import MOST_BEHIND_S, WINDOW_S, Pace, Simulated
from gateway.people.physics.world import Sensors, World
from gateway.people.walking.engine import Engine
from gateway.people.walking.robot import Robot
from gateway.simulation.elkapod import SimulatedElkapod
from schemas.robot import SERVO_IDS
from tests.walking.physics import run, stand_up

GEOMETRY = load()


@pytest.mark.parametrize("text", ["flat", "slope:10", "slope:-20", "rough:0.02", "step:0.02", "step:-0.1"])
def test_a_robot_lies_on_every_ground(text: str) -> None:
    world = World(GEOMETRY, Assumed(terrain=Terrain.parsed(text)))
    assert str(Terrain.parsed(text)) == text
    run(world, 1.0)
    body = world.body()
    assert body.upright
    assert body.tilt_deg < 10
    lean_deg = math.degrees(math.acos(rotated(body.rotation, (0, 0, 1))[2]))
    assert lean_deg == pytest.approx(abs(Terrain.parsed(text).slope_deg), abs=5)


@pytest.mark.parametrize(
    "text", ["", "hills", "slope", "slope:", "slope:90", "slope:nan", "rough:-1", "rough:1", "step:1", "flat:1"]
)
def test_what_is_no_terrain_is_reported_with_what_there_is(text: str) -> None:
    with pytest.raises(ConfigError, match=r"there are flat, slope:DEGREES .* rough:METRES .* and step:METRES"):
        assumed(None, None, None, text)


def test_a_robot_on_its_back_lies_there_until_it_is_set_upright() -> None:
    world = World(GEOMETRY)
    x, y, z, w = about((1, 0, 0), math.pi)
    world.data.qpos[:7] = 0.3, 0.2, 0.15, w, x, y, z
    run(world, 1.0)
    body = world.body()
    assert not body.upright
    assert body.tilt_deg > 150
    assert body.position_m[:2] == pytest.approx((0.3, 0.2), abs=0.05)
    world.set_upright()
    run(world, 1.0)
    body = world.body()
    assert body.upright
    assert body.tilt_deg < 10
    assert body.position_m[:2] == pytest.approx((0.3, 0.2), abs=0.05), "where it lay"


def test_an_explosion_names_the_leg_that_is_inside_something() -> None:
    """Legs 3 and 5 at one place. They do not collide, so that alone explodes nothing; it is reported all the same."""
    mounts = GEOMETRY.leg_mounts
    both = GEOMETRY.model_copy(update={"leg_mounts": {**mounts, 5: mounts[3]}})
    world = World(both)
    overlap = world.overlap()
    assert overlap is not None
    assert "leg 3 is in leg 5 25 mm deep" in overlap
    assert World(GEOMETRY).overlap() is None
    run(world, 0.5)
    assert world.fault() is None
    world.data.qvel[0] = math.nan
    world.step()
    sentence = world.fault()
    assert sentence is not None
    assert "leg 3 is in leg 5" in sentence or "leg 5 is in leg 3" in sentence


def test_a_geometry_that_mujoco_rejects_is_reported_in_one_line() -> None:
    with pytest.raises(ConfigError, match="MuJoCo cannot simulate elkapod: ") as raised:
        World(GEOMETRY, Assumed(mass_kg=0.0))
    assert "\n" not in str(raised.value)


# ---- angles as commands name them


def test_where_it_is_counts_as_commands_do() -> None:
    """A servo that is mounted the other way round, and 10 degrees off."""
    as_drawn = Simulated(GEOMETRY, Assumed())
    mounted = Simulated(GEOMETRY, Assumed())
    as_drawn.drive({servo_id: 60.0 if servo_id == 11 else None for servo_id in SERVO_IDS})
    mounted.drive({servo_id: 180 - 60.0 + 10 if servo_id == 11 else None for servo_id in SERVO_IDS})
    mounted.calibrate(RobotCalibration(1, {11: ServoMapping(trim_cdeg=1000, inverted=True)}))
    for each in (as_drawn, mounted):
        run(each.world, 1.0)
        report = each.report(1.0)
        assert report.servos["11"].angle_deg == pytest.approx(60, abs=1)
        assert report.servos["12"].torque_nm == 0
        assert report.servos.keys() == set(map(str, SERVO_IDS))


# ---- real time


def test_what_a_stall_cost_is_left_out_and_told_by_how_much() -> None:
    pace = Pace(0.002, 0.0)
    assert pace.due(1.5) * 0.002 == pytest.approx(MOST_BEHIND_S)
    assert pace.report(1.5) is None, "not before a window's end"
    pace.due(1.6)
    sentence = pace.report(WINDOW_S)
    assert pace.factor == pytest.approx(0.1, abs=0.02)
    assert sentence is not None
    assert "simulates 0.10 s of each second" in sentence
    now_s = WINDOW_S
    told = []
    for _ in range(round(2 * WINDOW_S / 0.01)):
        now_s += 0.01
        pace.due(now_s)
        told.append(pace.report(now_s))
    assert [each for each in told if each] == ["this machine simulates the body in real time again"]


# ---- the command line


def test_help_says_the_defaults() -> None:
    """They stand there as text, so that no command has to load the geometry for them."""
    shown = {
        name: parameter.show_default
        for name, annotation in run_command.__annotations__.items()
        for parameter in getattr(annotation, "__metadata__", ())
    }
    assert shown["mass_kg"].startswith(f"{MASS_KG}:")
    assert shown["servo_torque_nm"].startswith(f"{TORQUE_NM}:")
    assert shown["friction"].startswith(f"{FRICTION}:")
    assert pytest.approx(TOTAL_KG, abs=0.01) == MASS_KG
    assert shown["terrain"] == str(assumed(None, None, None, None).terrain)


# ---- what its sensors feel


def test_between_two_steps_it_feels_what_it_felt() -> None:
    world = World(GEOMETRY)
    sensors = Sensors(world)
    assert sensors.read().linear_acceleration_m_s2 == pytest.approx((0, 0, 9.81))
    run(world, 0.02)
    assert sensors.read() == sensors.read()


def test_who_carries_more_finds_its_battery_lower() -> None:
    world = World(GEOMETRY)
    stand_up(world, Engine(Robot(GEOMETRY)))
    sensors = Sensors(world)
    run(world, 0.1)
    held = sensors.read()
    volts = []
    for sensed in (held, held._replace(torques_nm=(0.0,) * len(SERVO_IDS))):
        page = SensedPage()
        page.write(sensed)
        controller = SimulatedElkapod(clock=lambda: 0, sensed=page)
        controller.exchange(bytes(elkapod.FRAME_BYTES))
        volts.append(elkapod.measured(controller.exchange(bytes(elkapod.FRAME_BYTES))).voltage_v)
    assert volts[0] < volts[1] - 0.05
