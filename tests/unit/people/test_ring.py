"""The black box: a record is in its ring whole or not at all; incidents are found in it, told and exported."""

import asyncio
import os
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader

from gateway import __version__
from gateway.geometry import load
from gateway.model import black_box as form
from gateway.model.black_box import INCIDENT_NAMES, MISTAKE, RING_FILE
from gateway.model.calibration import RobotCalibration, ServoMapping
from gateway.model.frames import STOP, Op, ServoOp, stop_leg
from gateway.people.incidents import ring_reader as rec
from gateway.people.incidents.find import CRASH, Incident, find
from gateway.people.incidents.messages import messages, write_file
from gateway.people.incidents.ring_reader import NoRingError
from gateway.people.incidents.story import WORDS, frames_in, headline, story
from gateway.people.recorder.drawing import JOINT_STATES
from gateway.robot.blackbox.ring import RecordRing
from gateway.robot.core.events import Announce
from gateway.robot.runtime.calibrations import Calibrations
from schemas import keys
from schemas.robot import SERVO_IDS
from schemas.words import Kind
from tests.support.published import AT_REST, ON_ITS_SIDE
from tests.support.recordings import about, checked, parse, put, read
from tests.support.robot import LEG_3, WALL_NS, Robot, leg
from tests.unit.people.test_recorder import recorded
from tests.unit.people.test_recordings import drawn_in, positions

pytestmark = pytest.mark.virtual_time

ALL_LEGS = tuple((servo_id, ServoOp(Op.SET, 180_00)) for servo_id in SERVO_IDS)
FRAME = stop_leg(3).data
WRITTEN: list[tuple[int, Callable[..., bytes], Callable[..., rec.Content], tuple[Any, ...]]] = [
    (form.START, form.fields, rec.Start, (5, {"version": "1", "simulated": True})),
    (form.END, form.fields, rec.Noted, ("end", "done")),
    (
        form.COMMAND,
        form.command,
        rec.CommandRecord,
        (7, "put", "hexapod/leg/3/cmd", "anna", 12.5, ((31, ServoOp(Op.START, 90_25)), (32, STOP))),
    ),
    (form.COMMAND, form.command, rec.CommandRecord, (8, "get", "hexapod/legs/cmd", "ä" * 64, None, ALL_LEGS)),
    (
        form.COMMAND,
        form.command,
        rec.CommandRecord,
        (9, "put", "a key", None, None, (), None, 5, 7, 8, ((9, "coalesced"), (2**32 - 1, "stale"))),
    ),
    (form.FRAME, form.frame, rec.FrameWritten, (FRAME, "watchdog", 45_000, 7)),
    (form.NOTE, form.fields, rec.Noted, ("left_out", "1234 records", "anna")),
    (form.EVENT, form.fields, rec.EventPublished, ("bus_fault", None, "k", None, "x" * 500, 3)),
    (form.INCIDENT, form.fields, rec.WallTime, (9, "20260101-000000-000-estop")),
]
"""A record's kind, how it is written, what is read of it, and its values."""


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "black-box"


def image(*records: tuple[int, bytes, int]) -> bytes:
    """Return a ring of these types, contents and times, in their order."""
    slots = len(records) + 1
    made = bytearray(form.new_header(slots).ljust(form.file_bytes(slots), b"\0"))
    for number, (kind, rest, ns) in enumerate(records, 1):
        put(made, form.HEADER_BYTES + number * form.SLOT, kind, number, ns, rest)
    return bytes(made)


def filled(path: Path, records: int, slots: int = 50) -> None:
    """Fill a ring with so many modes, numbered from 1."""
    ring = RecordRing(path, slots)
    for number in range(1, records + 1):
        ring.append(form.NOTE, number, form.fields("mode", str(number)))
    ring.close()


def modes(path: Path) -> list[int]:
    return [int(record.content.detail) for record in rec.read(path) if isinstance(record.content, rec.Noted)]


def test_everything_is_read_as_it_was_written(path: Path) -> None:
    ring = RecordRing(path, 100)
    for ns, (kind, write, _, values) in enumerate(WRITTEN):
        ring.append(kind, ns, write(*values))
    ring.append(99, 0, b"of a later version")
    ring.close()
    content = rec.read(path)
    assert [record.content for record in content] == [made(*values) for _, _, made, values in WRITTEN]
    assert [record.ns for record in content] == list(range(len(WRITTEN)))


@pytest.mark.parametrize("records", [0, 1, 49, 50, 51, 99, 100, 101, 1234])
def test_the_newest_are_kept_in_their_order(path: Path, records: int) -> None:
    filled(path, records)
    assert modes(path) == list(range(max(1, records - 49), records + 1))


def test_a_text_of_any_characters_is_no_error(path: Path) -> None:
    ring = RecordRing(path, 100)
    for text in ("\ud800", "x" * 300, "é" * 200, "\0\n"):
        ring.append(form.COMMAND, 0, form.command(1, "put", "key", text, None, ()))
        ring.append(form.EVENT, 0, form.fields("kind", text, text, text, text * 100, 0))
    ring.close()
    content = rec.read(path)
    assert len(content) == 8


def test_every_byte_counts(path: Path) -> None:
    """Each byte of a record changed once: it is never read as something else."""
    filled(path, 3)
    data = path.read_bytes()
    whole = parse(data)
    begin = form.HEADER_BYTES + 2 * form.SLOT
    used = 4 + 20 + len(form.fields("mode", "2"))
    for offset in range(used):
        changed = bytearray(data)
        changed[begin + offset] ^= 0x10
        assert list(parse(bytes(changed))) == [record for record in whole if record.sequence != 2]


def test_a_record_that_a_killed_gateway_began_states_nothing(path: Path) -> None:
    ring = RecordRing(path, 50)
    ring.append(form.EVENT, 0, form.fields("kind", None, None, None, "x" * 300, 0))
    ring.sequence -= 1  # the next gateway overwrites what is not whole
    ring.append(form.NOTE, 0, form.fields("mode", "7"))
    ring.close()
    assert (len(rec.read(path)), modes(path)) == (1, [7])


@pytest.mark.parametrize(
    "found",
    [
        b"#!/bin/sh\n" * 1000,
        b"short",
        form.new_header(40).ljust(form.file_bytes(40), b"\0"),
        form.new_header(50),
        form.new_header(50).replace(b"\n\x05", b"\n\x01").ljust(form.file_bytes(50), b"\0"),
    ],
    ids=["a script", "short", "another size", "cut off", "another version"],
)
def test_a_file_that_is_no_ring_is_begun_anew_and_reported(path: Path, found: bytes) -> None:
    path.write_bytes(found)
    path.chmod(0o600)
    ring = RecordRing(path, 50)
    assert ring.note == "the black box starts empty: its file is of another version or size"
    ring.append(form.NOTE, 0, form.fields("mode", "1"))
    ring.close()
    assert modes(path) == [1]
    assert path.stat().st_blocks * 512 >= path.stat().st_size, "no hole that a full disk would turn into SIGBUS"


def test_two_gateways_never_write_to_one_ring(path: Path) -> None:
    ring = RecordRing(path, 50)
    assert rec.read(path).written
    with pytest.raises(OSError, match="another gateway writes to it"):
        RecordRing(path, 50)
    ring.close()
    assert not rec.read(path).written
    RecordRing(path, 50).close()


def test_a_black_box_that_another_user_made_is_not_opened(path: Path, tmp_path: Path) -> None:
    elsewhere = tmp_path / "secret"
    elsewhere.write_text("mine")
    path.symlink_to(elsewhere)
    with pytest.raises(OSError, match="symbolic links"):
        RecordRing(path, 50)
    path.unlink()
    os.link(elsewhere, path)
    with pytest.raises(PermissionError, match="belongs to another user"):
        RecordRing(path, 50)
    assert elsewhere.read_text() == "mine"


def test_a_reader_says_what_it_cannot_read(path: Path, tmp_path: Path) -> None:
    for bad, sentence in ((tmp_path / "none", "No such file"), (tmp_path, "it is no black box|Is a directory")):
        with pytest.raises(NoRingError, match=sentence):
            rec.read(bad)
    os.mkfifo(path)
    with pytest.raises(NoRingError, match="it is no black box"):
        rec.read(path)


# ---- incidents


START = leg("start", 90, 45, 120, source="anna")
SECOND = 1_000_000_000


def incidents(folder: Path) -> tuple[list[Incident], rec.Records]:
    content = rec.read(folder / RING_FILE)
    return find(content), content


def exported(folder: Path, incident: Incident, content: rec.Records) -> Path:
    path = folder / f"{incident.name}.mcap"
    write_file(path, incident, content)
    return path


def told(folder: Path) -> list[str]:
    """Return the story of the only incident."""
    ((incident,), content) = incidents(folder)
    return story(list(messages(incident, content)))


async def silence(robot: Robot) -> None:
    robot.put(LEG_3, START)
    await asyncio.sleep(0.1)
    robot.put(LEG_3, leg("set", 90, 46, 120, source="anna"))
    await asyncio.sleep(1)


async def estop(robot: Robot) -> None:
    robot.put(LEG_3, START)
    await asyncio.sleep(0.05)
    robot.put(keys.ESTOP, {"source": "bert"})
    robot.put(LEG_3, START)
    robot.put(LEG_3, START)
    robot.put(keys.RESET, {"estop": 1, "source": "bert"})
    robot.put(keys.leg_command(4), START)


async def test_the_story_of_a_silent_leg(folder: Path) -> None:
    robot = recorded(folder)
    await asyncio.sleep(1)
    await silence(robot)
    ((incident,), _) = incidents(folder)
    assert robot.events(Kind.WATCHDOG_EXPIRED)[0].incident == robot.state().incident == incident.name
    lines = told(folder)
    assert (
        lines[0]
        == "20260921-141320-123-watchdog: a leg was silent, and was stopped: leg 3, at 2026-09-21T14:13:20.123457Z"
    )
    assert lines[1] == "Before it, anna sent 2 commands for leg 3."
    assert [line.strip() for line in lines[-8:]] == [
        "−0.250 s  last command of leg 3 (anna, set 90 46 120)",
        "0.000 s  watchdog: no command for leg 3 in 250 ms; it is stopped",
        "0.000 s  Stop written to leg 3 (watchdog)",
        "0.000 s  Stop repeated for legs 1, 2, 4, 5 and 6, the last at 0.000 s",
        "0.000 s  mode idle",
        "+20.0 ms  Stop repeated for all legs, the last at +20.0 ms",
        "+40.0 ms  Stop repeated for all legs, the last at +40.0 ms",
        "+60.0 ms  Stop repeated for all legs, the last at +60.0 ms",
    ]


async def test_a_gateway_that_stood_still_is_not_reported_as_a_silent_leg(folder: Path) -> None:
    robot = recorded(folder)
    robot.put(LEG_3, START)
    robot.sleep_through(4.2)
    robot.put(LEG_3, leg("set", 90, 46, 120, source="anna"))
    robot.conductor.recorder.beat(4_100_000_000)
    await asyncio.sleep(0.1)
    assert ": the gateway stood still for 4.1 s; commands kept coming, at " in told(folder)[0]


async def test_the_headline_names_the_worst_and_who_and_which_legs(folder: Path) -> None:
    robot = recorded(folder)
    robot.put(keys.leg_command(2), START)
    robot.put(LEG_3, START)
    for _ in range(10):
        await asyncio.sleep(0.1)
        robot.put(keys.leg_command(2), leg("set", 90, 46, 120, source="anna"))
    lines = told(folder)
    assert ": a leg was silent, and was stopped: leg 3, at " in lines[0]
    assert not [line for line in lines if "first command after it" in line], "leg 2 walked throughout"
    robot.put(keys.ESTOP, {"source": "bert"})
    ((incident,), content) = incidents(folder)
    silent = "a leg was silent, and was stopped: leg 3"
    worst = f"somebody requested an emergency stop (bert); also: {silent}"
    assert f": {worst}, at " in told(folder)[0]
    assert headline(messages(incident, content)) == worst
    robot.conductor.recorder.close()
    assert f": the gateway ended without a word; also: {silent}; also: somebody" in told(folder)[0]


LANDING = {"watchdog": {"landing_ms": 500, "landing": {"31": 30.0}}, "rules": {"repeats": 0}}


async def test_a_calibrated_robots_story_and_picture_have_its_users_angles(folder: Path) -> None:
    robot = recorded(folder, **LANDING)
    trimmed = RobotCalibration(1, {32: ServoMapping(10_00, inverted=True)}, {})
    robot.conductor.supervisor.calibrating.load(trimmed)
    Calibrations(robot.conductor, None).publish()
    robot.put(LEG_3, START)
    await asyncio.sleep(2)
    robot.conductor.recorder.calibration(RobotCalibration(2))  # of later frames
    await asyncio.sleep(10)
    (incident,), content = incidents(folder)
    path = exported(folder, incident, content)
    told = list(read(path))
    (way_down,) = [line for line in story(told) if "last frame of the way down" in line]
    assert way_down.endswith("leg 3 at 30 45 120")
    started = next(frame for _, frame in frames_in(told) if not frame.is_stop)
    assert [op.angle_cdeg for _, op in started.servos] == [90_00, 45_00, 120_00]
    joints = positions(drawn_in(path, JOINT_STATES)[-1])
    assert joints["joint_32"] == pytest.approx(load().joint_rad(32, 45.0), abs=1e-4)
    revisions = [each.content["revision"] for each in told if each.topic == keys.CALIBRATION]
    assert revisions == [1, 2], "at its beginning, and what a change brings"


async def test_a_landing_that_somebody_stops_and_the_next_one_are_two(folder: Path) -> None:
    robot = recorded(folder, **LANDING)
    for _ in range(2):
        robot.put(LEG_3, START)
        await asyncio.sleep(0.35)
        robot.put(LEG_3, leg("stop", source="bert"))
    text = [line.partition("  ")[2].strip() for line in told(folder)]
    assert [line for line in text if "way down" in line or "Stop written to leg" in line] == [
        "first frame of the way down",
        "last frame of the way down, after 7 frames; leg 3 at 76.96 45 120",
        "Stop written to leg 3 (command)",
    ] * 2


async def test_a_gateway_that_was_killed_is_an_incident_and_one_that_ended_is_none(folder: Path) -> None:
    robot = recorded(folder)
    robot.put(LEG_3, START)
    assert incidents(folder)[0] == [], "it runs"
    robot.conductor.recorder.close()
    ((crash,), content) = incidents(folder)
    assert crash.name == "20260921-141320-123-crash"
    lines = story(list(messages(crash, content)))
    assert lines[-1].strip() == "0.000 s  the gateway's last record; its process ended without a word"
    await asyncio.sleep(0.1)
    after = recorded(folder)
    assert [each.name for each in incidents(folder)[0]] == [crash.name], "the next gateway continues the ring"
    after.put(keys.ESTOP, {"source": "bert"})
    await asyncio.sleep(0.1)
    (_, later), content = incidents(folder)
    lines = [line.split("  ")[1] for line in story(list(messages(later, content)))[2:]]
    ends = [line for line in lines if line.startswith(("a gateway starts", "the gateway"))]
    assert [line.split(" (")[0] for line in ends] == [
        "a gateway starts",
        "the gateway's last record; its process ended without a word",
        "a gateway starts",
    ], "told in the story of the next incident, too"
    after.conductor.recorder.ended("asked to")
    after.conductor.recorder.close()
    assert [each.name for each in incidents(folder)[0]] == [crash.name, later.name]


# ---- files


async def test_an_incident_is_a_file_that_mcaps_own_reader_reads_and_its_schemas_hold(folder: Path) -> None:
    robot = recorded(folder)
    await estop(robot)
    robot.put(LEG_3, b"{")
    ((incident,), content) = incidents(folder)
    path = exported(folder, incident, content)
    seen = Counter(topic for topic, _ in checked(path))
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    topics = sorted(channel.topic for channel in summary.channels.values())
    assert topics == sorted(seen), "viewers show a topic as its first channel, and list channels that are empty"
    assert {keys.FRAME, keys.EVENT, LEG_3, "hexapod/recorder", "/joint_states", "/tf"} <= seen.keys()
    frames = [message.content["bytes"] for message in read(path) if message.topic == keys.FRAME]
    assert frames == [data.hex() for _, data in robot.controller.transfers]
    assert story(list(read(path))) == story(list(messages(incident, content)))
    assert_ordered(path)


async def test_an_incidents_file_has_the_settings_of_the_gateway_that_it_happened_to(folder: Path) -> None:
    first = recorded(folder, watchdog={"timeout_ms": 300})
    first.conductor.recorder.beat(0)
    await silence(first)
    first.conductor.recorder.ended("asked to")
    first.conductor.recorder.close()
    second = recorded(folder, watchdog={"timeout_ms": 500}, spi={"framing": "length-prefixed"})
    second.conductor.recorder.beat(0)
    await estop(second)
    (before, after), content = incidents(folder)
    facts = [about(exported(folder, each, content)) for each in (before, after)]
    assert [each["watchdog"]["timeout_ms"] for each in facts] == [300, 500]
    assert [each["spi"]["framing"] for each in facts] == ["plain", "length-prefixed"]
    assert {each["version"] for each in facts} == {__version__}


async def test_an_incident_shows_tilt_battery_and_feet_around_it(folder: Path) -> None:
    robot = recorded(folder, wire={"name": "elkapod-2025"})
    measured = robot.conductor.measured
    measured(AT_REST, robot.now_ns())
    await asyncio.sleep(1)
    measured(AT_REST._replace(voltage_v=6.5), robot.now_ns())  # under load
    await asyncio.sleep(1)
    measured(ON_ITS_SIDE._replace(feet=(0.0,) * 6), robot.now_ns())
    await asyncio.sleep(0.2)
    robot.conductor.reports.announce(
        Announce(Kind.FALLEN, "the body tilts by 82°, beyond 45°; all six legs are stopped")
    )
    await asyncio.sleep(1)
    measured(AT_REST._replace(orientation_wxyz=(0.0, 1.0, 0.0, 0.0)), robot.now_ns())
    ((incident,), content) = incidents(folder)
    assert incident.name == "20260921-141320-123-fallen"
    path = exported(folder, incident, content)
    seen = Counter(topic for topic, _ in checked(path))
    assert seen[keys.TELEMETRY] == 4
    assert_ordered(path)
    told = story(list(read(path)))
    assert told == story(list(messages(incident, content)))
    assert ": the body tilted too far, and all legs were stopped, at " in told[0]
    assert [line.strip() for line in told if ", battery " in line] == [
        "−1.200 s  battery lowest: tilt 0.0°, battery 6.50 V (80 %), 31.5 °C, feet 1 2 3 4 5 6",
        "−0.200 s  measured: tilt 82.4°, battery 7.50 V (80 %), 31.5 °C, feet 0 0 0 0 0 0",
        "+1.000 s  tilted most: tilt 180.0°, battery 7.50 V (80 %), 31.5 °C, feet 1 2 3 4 5 6",
    ]


def assert_ordered(path: Path) -> None:
    """Check that no message is logged earlier than the previous one: Rerun would seek slowly."""
    with path.open("rb") as file:
        times_ns = [message.log_time for _, _, message in make_reader(file).iter_messages(log_time_order=False)]
    assert times_ns == sorted(times_ns)


def test_what_happens_in_its_time_prolongs_an_incident_up_to_half_a_minute() -> None:
    def found(*later_s: float) -> Incident:
        """Return the incidents of a watchdog at 20 s, after a gateway's start, and emergency stops at these seconds."""
        silent = form.fields(WALL_NS, "20260921-141320-123-watchdog")
        behind = [(form.START, form.fields(WALL_NS, {}), SECOND), (form.INCIDENT, silent, 20 * SECOND)]
        stop = form.fields("estop_engaged", "anna", None, None, "a sentence", 0)
        behind += [(form.EVENT, stop, round(at_s * SECOND)) for at_s in (20.0, *later_s)]
        records = parse(image(*behind))
        records.written = True
        (incident,) = find(records)
        return incident

    assert (found().begin_ns, found().end_ns) == (10 * SECOND, 25 * SECOND)
    assert found(24.0, 28.0).end_ns == 33 * SECOND
    assert found(25.1).end_ns == 25 * SECOND, "it is over"
    assert found(*range(24, 65, 4)).end_ns == 50 * SECOND


@pytest.mark.parametrize(("second", "crashes"), [(2, 1), (5, 0)])
def test_where_records_are_missing_nobody_knows_how_a_gateway_ended(second: int, crashes: int) -> None:
    made = bytearray(form.new_header(10).ljust(form.file_bytes(10), b"\0"))
    for number in (1, second):
        put(made, form.HEADER_BYTES + number * form.SLOT, form.START, number, number, form.fields(WALL_NS, {}))
    records = parse(bytes(made))
    records.written = True
    assert len(find(records)) == crashes


def test_every_kind_of_incident_has_its_words_and_its_rank() -> None:
    kinds = {*INCIDENT_NAMES.values(), MISTAKE, CRASH}
    assert kinds <= WORDS.keys()
