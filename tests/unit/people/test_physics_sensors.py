"""What the sensors of the simulated body feel: as it stands, on a slope, while it falls, on its back."""

import pytest

from gateway.geometry import load
from gateway.host.shared_page import Sensed, SensedPage
from gateway.model import elkapod
from gateway.model.elkapod import Measured
from gateway.people.physics.assumed import Assumed, Terrain
from gateway.people.physics.world import Sensors, World
from gateway.people.walking import Engine, Robot
from gateway.simulation.elkapod import SimulatedElkapod
from schemas.robot import SERVO_IDS
from tests.walking.physics import run, stand_up

GEOMETRY = load()
G = 9.81


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


def test_between_two_steps_it_feels_what_it_felt() -> None:
    world = World(GEOMETRY)
    sensors = Sensors(world)
    assert sensors.read().linear_acceleration_m_s2 == pytest.approx((0, 0, G))
    run(world, 0.02)
    assert sensors.read() == sensors.read()


def test_who_carries_more_finds_its_battery_lower() -> None:
    _, sensors = standing()
    held = sensors.read()
    slack = held._replace(torques_nm=(0.0,) * len(SERVO_IDS))
    assert on_the_wire(held).voltage_v < on_the_wire(slack).voltage_v - 0.05
