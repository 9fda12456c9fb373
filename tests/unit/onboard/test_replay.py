"""`incidents replay`: an incident is decided again, also on another computer, and by a later version or not at all."""

import asyncio
import json
import re
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any
from zlib import compress

import pytest

from gateway.model import black_box as form
from gateway.model.black_box import RING_FILE
from gateway.model.power_board import SERVO_OVERCURRENT
from gateway.model.protocols import called
from gateway.onboard.replay import RULES, change_of, seconds
from gateway.robot.core.rules import Rules
from gateway.robot.settings import Settings
from schemas import keys
from schemas.robot import LEGS
from schemas.words import Cause, Kind, Reason
from tests.support.command import Ended, run_here
from tests.support.power import FedRobot
from tests.support.recordings import put
from tests.support.robot import Robot, leg, servo

INCIDENT = "20260921-141320-123"


def of_ring(folder: Path, *arguments: str) -> Ended:
    config = folder.parent / "gateway.toml"
    config.write_text(f'state.path = "{folder}"\n')
    return run_here("incidents", "replay", *arguments, "--config", str(config))


async def driven(robot: Robot, seconds_s: float, *legs: int, source: str = "anna", **more: Any) -> None:
    """Move these legs at 50 Hz, with the service's beats."""
    for turn in range(round(seconds_s * 50)):
        if turn % 5 == 0:
            robot.conductor.recorder.beat(0)
        for number in legs:
            op = "set" if robot.conductor.supervisor.legs.servos[number * 10 + 1].will_run else "start"
            robot.put(keys.leg_command(number), leg(op, 60 + turn % 40, 45, 120, source=source, **more))
        await asyncio.sleep(0.02)


def recorded(robot: Robot) -> Robot:
    if not isinstance(robot, FedRobot):
        robot.conductor.start()
    robot.conductor.recorder.open(nullcontext())
    return robot


async def taken_over(robot: Robot) -> None:
    token = robot.lease("acquire", "anna").lease
    await driven(robot, 1, *LEGS, lease=token)
    token = robot.lease("take", "ben").lease
    await driven(robot, 1, *LEGS, source="ben", lease=token)
    await driven(robot, 0.1, 1, lease="an older one")


async def failed(robot: Robot) -> None:
    robot.controller.fail_next(2)
    await driven(robot, 1, 1, 2, 3)


async def stopped(robot: Robot) -> None:
    robot.put(keys.servo_command(31), servo("stop"))
    robot.put(keys.LEGS_COMMAND, {"legs": {"1": leg("stop"), "2": leg("start", 9, 9, 9)}})
    robot.put(keys.leg_command(4), leg("stop", unknown=1))
    robot.each_takes_ns = 1000
    robot.put_later(keys.leg_command(5), leg("stop"))
    robot.put_later(keys.servo_command(51), servo("start", 9))  # of the same instant, so it does not start
    robot.conductor.tick()
    robot.each_takes_ns = 0
    robot.put(keys.ESTOP, {"source": "ben"})
    await driven(robot, 1, 1)
    robot.put(keys.RESET, {"estop": 1})
    await driven(robot, 1, 1)


async def without_buttons(robot: Robot) -> None:
    token = robot.button("register", "ben").button
    for count in range(20):
        assert robot.button("alive", button=token, count=count).accepted
        await driven(robot, 0.1, 1, 2)
    await driven(robot, 2, 1, 2)


async def unpowered(robot: Robot) -> None:
    assert isinstance(robot, FedRobot)
    robot.line.board.fail(SERVO_OVERCURRENT, 0b111)
    await driven(robot, 1, 1, 2)


async def silent(robot: Robot) -> None:
    await driven(robot, 1, 2)


SCENES: dict[str, tuple[Callable[..., Robot], dict[str, Any], Callable[[Robot], Any]]] = {
    "watchdog": (Robot, {}, silent),
    "landing": (Robot, {"watchdog": {"landing_ms": 800, "landing": {"11": 10.0}}}, silent),
    "estop": (Robot, {"limits": {"start_stagger_ms": 15}}, stopped),
    "lease-taken": (Robot, {"limits": {"servos": {"11": {"max_speed_deg_s": 30}}}}, taken_over),
    "bus-fault": (Robot, {"spi": {"framing": "length-prefixed"}}, failed),
    "button": (Robot, {"buttons": {"required": 1}}, without_buttons),
    "power-fault": (lambda sections: FedRobot(**sections), {}, unpowered),
}


async def played(folder: Path, what: str) -> str:
    make, sections, happens = SCENES[what]
    robot = recorded(make({**sections, "state": {"path": str(folder)}}))
    await asyncio.sleep(1.5)
    await driven(robot, 6, *LEGS)
    await happens(robot)
    robot.conductor.recorder.ended("done")
    robot.conductor.recorder.close()
    return what


@pytest.mark.virtual_time
@pytest.mark.parametrize("what", SCENES)
async def test_an_incident_has_the_same_frames_and_makes_a_test_that_passes(folder: Path, what: str) -> None:
    await played(folder, what)
    test = folder.parent / "test_incident.py"
    ended = of_ring(folder, "last", "--as-test", str(test))
    assert (ended.returncode, ended.stderr) == (0, f"{INCIDENT}-{what} is in {test}\n"), ended.stdout
    assert "the same" in ended.stdout.splitlines()[-1]
    frames = json.loads(of_ring(folder, "last", "--json").stdout)["frames"]
    assert frames > 300, "of the last seconds"
    spaces: dict[str, Any] = {}
    exec(test.read_text(), spaces)  # noqa: S102  (the test that was written)
    spaces["test_the_same_frames_are_written"]()
    assert len(spaces["STEPS"]) > 15
    assert of_ring(folder, "last", "--as-test", str(test)).returncode == 2, "it exists"


@pytest.mark.virtual_time
async def test_the_timeline_names_the_rule_that_decided(folder: Path) -> None:
    await played(folder, "watchdog")
    lines = of_ring(folder, "last").stdout.splitlines()
    assert any("Watchdog → no command for leg 1 in 250 ms; " in line for line in lines)
    shorter = of_ring(folder, "last", "--until", "-0.1 s").stdout.splitlines()
    assert not any("Watchdog" in line for line in shorter[1:])


@pytest.mark.virtual_time
async def test_with_another_setting_the_first_difference_is_shown(folder: Path) -> None:
    await played(folder, "watchdog")
    ended = of_ring(folder, "last", "--set", "watchdog.timeout_ms=400")
    assert ended.returncode == 1
    assert ended.stdout.splitlines()[-1].startswith("Different at +")
    assert "no command for leg 1 in 400 ms" in ended.stdout
    assert of_ring(folder, "last", "--set", "watchdog.timeout_ms=250").returncode == 0
    for wrong, sentence in {
        "watchdog.timeout_ms": "write NAME=VALUE",
        "zenith.listen=x": "write NAME=VALUE, with a setting's name",
        'zenoh.listen=["tcp/[::]:7447"]': "it is no setting of the core",
        "controller.uart=/dev/ttyS0": "it is no setting of the core",
        "power.confirm_ms=500": "it is no setting of the core",
        "wire.name=no-wire": "wire: ",
        "wire.mood=good": "wire.mood: is no setting",
        "safety.max_tilt_deg=30": "safety.max_tilt_deg: hexapod-1.0 has nothing that measures it",
        "watchdog.timeout_ms=soon": "watchdog.timeout_ms: ",
        "watchdog.time=1": "watchdog.time: ",
        "limits.max_age_ms=0": "whose rules do not depend on it",
    }.items():
        ended = of_ring(folder, "last", "--set", wrong)
        assert ended.returncode == 2
        assert sentence in ended.stderr


ABOUT = {name: asdict(getattr(Settings(), name)) for name in form.SETTINGS} | {"wire": {"name": "hexapod-1.0"}}


@pytest.mark.parametrize(
    ("assignments", "changes"),
    [
        (["power.interface=socketcan"], {"power": True, "start_pause_ns": 0}),
        (["power.interface=socketcan", "limits.start_stagger_ms=30"], {"power": True, "start_pause_ns": 30_000_000}),
        (["spi.framing=length-prefixed"], {"avoid_cdeg": (1_00, 4_00)}),
        (["limits.start_stagger_ms=15"], {}),
        (["limits.servos.11.max_deg=90"], {"joint_limits_cdeg": {11: (0, 90_00)}}),
        (
            ["wire.name=elkapod-2025", "safety.max_tilt_deg=30"],
            {"wire": "elkapod-2025", "starts_whole": True, "whole_robot": True, "start_pause_ns": 0,
             "angles_first": True, "max_tilt_cdeg": 30_00},
        ),
        (
            ["wire.name=elkapod-2025", "power.interface=socketcan"],
            {"wire": "elkapod-2025", "power": True, "start_pause_ns": 0, "angles_first": True},
        ),
    ],
)  # fmt: skip
def test_a_setting_changes_the_rules_that_follow_from_it(assignments: list[str], changes: dict[str, Any]) -> None:
    change, found = change_of(ABOUT, assignments), Rules(joint_limits_cdeg={21: (0, 1)}, timeout_ns=7)
    assert change is not None
    expected = {each.name: getattr(found, each.name) for each in fields(Rules)} | changes
    expected |= {"wire": called(expected["wire"])} if "wire" in changes else {}
    assert {each.name: getattr(change(found), each.name) for each in fields(Rules)} == expected


def spoil(folder: Path, kind: int, *, before_zero: int, rest: bytes | None = None) -> None:
    """Damage the slots of this kind but for the first `before_zero` ones, or replace their records."""
    path = (folder / RING_FILE).resolve()
    found = path.read_bytes()
    slots, data = form.slots_of(found[: form.HEADER_BYTES], len(found)), bytearray(found)
    whole = [slot for each in range(slots) if (slot := form.read_slot(form.slot_bytes(found, each)))]
    for slot in [each for each in whole if each.kind == kind][before_zero:]:
        at = form.HEADER_BYTES + slot.sequence % slots * form.SLOT
        data[at] ^= 1
        if rest is not None:
            put(data, at, kind, slot.sequence, slot.ns, rest)
    path.write_bytes(data)


@pytest.mark.virtual_time
async def test_records_that_cannot_be_played_are_named_and_the_rest_is_played(folder: Path) -> None:
    await played(folder, "watchdog")
    ring = (folder / RING_FILE).resolve()
    whole = ring.read_bytes()
    for copy in form.copies_of(ring):
        copy.unlink()
    unknown = compress(b'{"format":99}')
    for kind, count, rest, played_in_part, sentence in (
        (form.CARRIED_OUT, 1500, None, True, "the records that followed are overwritten or damaged"),
        (form.STEP, 5, b"\0" * 9 + b'{"Dream":{}}', True, "it has a Dream, which this version does not know"),
        (form.KEYFRAME, 0, None, False, "the black box has no state from before it"),
        (form.KEYFRAME, 0, unknown, False, "its format is 99, and this version reads 1"),
    ):
        ring.write_bytes(whole)
        spoil(folder, kind, before_zero=count, rest=rest)
        ended = of_ring(folder, "last")
        assert (ended.returncode, sentence in ended.stderr) == (2, True), ended.stdout + ended.stderr
        assert ("Decided again from" in ended.stdout) is played_in_part


@pytest.mark.virtual_time
async def test_records_lost_in_a_flood_are_named_and_the_rest_is_played(folder: Path) -> None:
    robot = recorded(Robot({"limits": {"leg_rate_hz": 2}, "state": {"path": str(folder)}}))
    await asyncio.sleep(1.5)
    await driven(robot, 1, 1, source="ben")
    await driven(robot, 1, 1, 2)
    robot.put(keys.ESTOP, {"source": "anna"})
    robot.conductor.recorder.close()
    ended = of_ring(folder, "last")
    assert ended.returncode == 2, ended.stdout
    assert "events are missing: a source sent more than the black box has room for" in ended.stderr
    assert "ben: " in ended.stdout
    assert "Decided again from" in ended.stdout


@pytest.mark.virtual_time
async def test_an_incident_of_another_robot_plays_on_a_laptop(folder: Path) -> None:
    """It has other settings, and neither the robot's device nor its folder."""
    await played(folder, "landing")
    ring, laptop = (folder / RING_FILE).resolve(), folder.parent / "laptop"
    laptop.mkdir()
    for file in ring.parent.glob(f"{ring.name}*"):
        (laptop / file.name.replace(ring.name, RING_FILE)).write_bytes(file.read_bytes())
        file.unlink()
    config = laptop / "laptop.toml"
    config.write_text(
        f'state.path = "{laptop}"\nspi.device = "/dev/none"\nwire.name = "elkapod-2025"\n'
        "[watchdog]\ntimeout_ms = 3000\n[lease]\nrequired = true\n[limits]\nleg_rate_hz = 7\n"
    )
    ended = run_here("incidents", "replay", "last", "--config", str(config))
    assert (ended.returncode, ended.stderr) == (0, "")
    lines = ended.stdout.splitlines()
    assert " 0.000 s  time passed → Landing → no command for leg 1 in 250 ms" in lines
    assert re.fullmatch(r"Decided again from −\S+ s: the same \d+ frames\.", lines[-1])


def test_each_rule_of_a_timeline_is_in_the_contract() -> None:
    page = (Path(__file__).parents[3] / "docs" / "interface.md").read_text()
    assert all(f"**{name}.**" in page or f"**{name}:**" in page for name in RULES.values())
    assert {*Cause} <= RULES.keys()
    known = {name for name in (*Kind, *Reason) if name in RULES}
    assert {*Kind, *Reason} - known == {
        Kind.STARTED, Kind.COMMAND_REJECTED, Kind.LEGS_STOPPED, Kind.BUS_MEDDLED, Kind.REVOKED,
        Kind.ESTOP_KEPT, Kind.ESTOP_NOT_KEPT, Reason.TOO_LARGE, Reason.BAD_ENCODING, Reason.MALFORMED,
        Reason.REVOCATION_DENIED,
    }  # fmt: skip


@pytest.mark.parametrize(
    ("text", "ns"),
    [("0.25", 250_000_000), ("-1.5 s", -1_500_000_000), ("+20.4 ms", 20_400_000), ("−0.1", -100_000_000)],
)
def test_a_time_is_read_as_the_timeline_has_it(text: str, ns: int) -> None:
    assert seconds(text) == ns
