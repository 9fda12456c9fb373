"""Who is driving: two laptops with certificates, each on its own link, one robot, and an observer on the robot.

What moves is told by frames: all of a laptop's setpoints carry its mark. What is promised of time is between two
reports by the gateway's clock.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from gateway.model.frames import decode
from schemas.robot import LEGS
from schemas.telemetry import Event, FrameRecord, Kind, Reason
from tests.net.conftest import Hosts
from tests.net.hosts import LaptopHost, RobotHost, is_from, with_certificates
from tests.net.namespaces import Network
from tests.support.heard import states

pytestmark = pytest.mark.net

PORT = 7450
TTL_MS = 1000.0
LATE_MS = 500
"""What a busy machine may add to it."""
QUEUED = 12
"""Setpoints of each leg: fewer than a ring holds, since a full ring counts as a Stop."""
METRICS = "127.0.0.1:9464"


class Scene(Hosts):
    """The robot, the laptops, and every token that was given."""

    def __init__(self, robot: RobotHost, anna: LaptopHost, bert: LaptopHost, black_box: Path) -> None:
        super().__init__(robot, (anna, bert))
        self.black_box = black_box
        self.anna, self.bert = anna, bert
        self.tokens: set[str] = set()
        self.states = states(robot.client)

    def lease(self, laptop: LaptopHost, how: str) -> str:
        """Hold it; the holder's name."""
        return self.granted(laptop.ask(f"lease {how}"))

    def granted(self, answer: dict[str, object]) -> str:
        assert answer.get("verified") is True, answer
        self.tokens.add(str(answer["token"]))
        return str(answer["holder"])

    def wait_for(self, kind: Kind) -> Event:
        return self.robot.wait_for_event(lambda event: event.kind == kind)


@pytest.fixture(scope="module")
def scene(hosts_network: Network, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Scene]:
    """Started once for all tests of this file."""
    folder = tmp_path_factory.mktemp("lease")
    settings: dict[str, dict[str, Any]] = {
        "lease": {"ttl_ms": TTL_MS},
        "telemetry": {"metrics": METRICS},
        "state": {"path": str(folder / "black box")},
    }
    with with_certificates(hosts_network, folder, "anna", "bert", port=PORT, settings=settings) as (robot, laptops):
        anna, bert = laptops
        yield Scene(robot, anna, bert, folder / "black box")


@pytest.fixture(autouse=True)
def _at_rest(scene: Scene, network: Network) -> None:
    """Links are up, nobody drives, nothing runs."""
    del network
    for laptop in scene.laptops:
        laptop.ask("pause")
        laptop.ask("in-reach")
        laptop.ask("release")
    scene.robot.at_rest()
    assert scene.robot.client.state().lease.holder is None


def is_stop(frame: FrameRecord) -> bool:
    """Whether it de-energises a servo, whatever its cause."""
    return decode(bytes.fromhex(frame.bytes)).is_stop


def drive(scene: Scene, laptop: LaptopHost) -> None:
    """All six legs, at 50 Hz."""
    laptop.start(*LEGS)
    laptop.stream(*LEGS)
    scene.robot.wait_for_commands(*LEGS)


def test_while_anna_drives_bert_is_rejected_told_her_name_and_may_stop(scene: Scene) -> None:
    robot, anna, bert = scene.robot, scene.anna, scene.bert
    assert scene.lease(anna, "acquire") == "anna"
    drive(scene, anna)
    answer = bert.ask("try 1")
    assert (answer["accepted"], answer["reason"]) == (False, Reason.NOT_HOLDER)
    assert "anna" in answer["detail"]
    held = bert.ask("lease acquire")
    assert (held["rejected"], held["holder"]) == (Reason.LEASE_HELD, "anna")
    assert not robot.seen(is_from(bert))
    assert robot.running == {*LEGS}
    lease = robot.client.state().lease
    assert (lease.holder, lease.verified, lease.asked_by) == ("anna", True, None)
    anna.ask("pause")
    assert bert.ask("stop")["accepted"]
    assert not robot.running
    assert bert.ask("estop")["stop_frames"] == len(LEGS)
    reset = bert.ask("reset")
    assert (reset["accepted"], reset["reason"]) == (False, Reason.NOT_HOLDER)
    assert anna.ask("reset")["accepted"]


def test_bert_takes_it_by_force_and_nothing_that_anna_queued_moves_a_leg(scene: Scene, network: Network) -> None:
    robot, anna, bert = scene.robot, scene.anna, scene.bert
    scene.lease(anna, "acquire")
    drive(scene, anna)
    network.cut(0)
    anna.ask(f"pause {anna.ask('sent')['sent'] + QUEUED * len(LEGS)}")
    robot.forget()
    assert scene.lease(bert, "take") == "bert"
    assert {leg_of(frame) for frame in robot.seen(is_stop)} == {*LEGS}
    assert not robot.running
    taken = scene.wait_for(Kind.LEASE_TAKEN)
    assert "anna" in taken.detail
    bert.start(*LEGS)
    bert.stream(*LEGS)
    robot.wait_for_frames(is_from(bert), 1)
    stops, begun = robot.seen(is_stop), robot.seen(is_from(bert))
    assert max(stop.monotonic_ns for stop in stops) < begun[0].monotonic_ns
    rejected = robot.rejected
    robot.forget()
    network.fix(0)
    lost = anna.ask("lost")
    assert (lost["rejected"], lost["holder"]) == (Reason.NOT_HOLDER, "bert")
    anna.ask("state")  # comes by the same way, behind them
    print(f"{robot.rejected - rejected} of {QUEUED * len(LEGS)} queued Sets were read, and rejected")
    scene.states.wait(lambda state: state.commands.rejected >= rejected + len(LEGS))
    assert not robot.seen(is_from(anna))
    assert robot.running == {*LEGS}
    assert anna.ask("try 1")["rejected"] == Reason.NOT_HOLDER
    assert anna.ask("stop")["accepted"]
    assert anna.ask("estop")["stop_frames"] == len(LEGS)
    bert.ask("pause")
    assert bert.ask("reset")["accepted"]


def leg_of(frame: FrameRecord) -> int:
    return decode(bytes.fromhex(frame.bytes)).servos[0][0] // 10
