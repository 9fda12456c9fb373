"""Starts without `sent_ms`: ordinary programs run, and what a link has held back starts nothing."""

import json
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from itertools import product
from random import Random
from typing import Any, Final, NamedTuple

import pytest

from gateway.model.frames import STOP, Op, ServoOp, servo_ids_of
from gateway.rate_limit import NS_PER_MS
from gateway.robot.core.backlog import START_WAIT_NS
from gateway.robot.core.events import BusFailed, BusOpened, Command, Rejected, ShutDown, TimePassed, Transmit
from gateway.robot.core.message import Verb
from gateway.robot.core.rules import Rules
from gateway.robot.core.supervisor import Supervisor
from gateway.robot.zenoh_io.rings import RING_DEPTH, put_depth
from schemas.keys import COMMAND_KEYS, LEGS_COMMAND, Target, leg_command, servo_command
from schemas.robot import LEGS
from tests.support.history import frames_of
from tests.support.scenes import play, scene_test

SEGMENT: Final = 1448
"""Bytes of a program that a TCP segment carries on Ethernet and Wi-Fi."""
OVERHEAD: Final = 40
"""Bytes around a payload: Zenoh's lengths and headers, the key, the encoding."""


class Arrival(NamedTuple):
    """A message at the gateway."""

    at_ms: float
    key: str
    op: Op
    verb: Verb = Verb.PUT

    @property
    def size(self) -> int:
        """Return its bytes on the link."""
        one = {"op": self.op.name.lower(), "angle_deg": 91.37}
        leg = {"servos": [one] * 3}
        target = COMMAND_KEYS[self.key].target
        payloads = {Target.SERVO: one, Target.LEG: leg, Target.LEGS: {"legs": {str(each): leg for each in LEGS}}}
        return len(json.dumps(payloads[target])) + OVERHEAD


def delivered(sent: Iterable[Arrival], mbit_s: float) -> Iterator[Arrival]:
    """Deliver what a link has held back from 0 ms on, in full segments; 0 Mbit/s: all at once."""
    end = 0
    for each in sent:
        end += each.size
        segments = -(-end // SEGMENT)  # a message is complete with its last segment
        yield each._replace(at_ms=segments * SEGMENT * 8 / mbit_s / 1000 if mbit_s else 0.0)


def targets_of(key: str, op: ServoOp) -> tuple[tuple[int, ServoOp], ...]:
    """Return what a message on this key names."""
    target, number = COMMAND_KEYS[key]
    legs = {Target.LEGS: tuple(LEGS), Target.LEG: (number,)}.get(target, ())
    return tuple((servo, op) for leg in legs for servo in servo_ids_of(leg)) or ((number, op),)


class Robot:
    """A supervisor behind a model of the reader: a ring for each key, of which it reads the newest messages."""

    def __init__(
        self,
        rules: Rules,
        *,
        each_ms: float = 0.1,
        wake_ms: float = 0.1,
        pauses: Sequence[tuple[float, float]] = (),
        timed: bool = False,
    ) -> None:
        """`each_ms`: how long a message takes; `wake_ms`: how long the reader takes to wake up; `timed`: has `sent_ms`.

        During `pauses` (from, to; in ms) the machine is busy, and the reader does not run.
        """
        self.supervisor = Supervisor(rules)
        self.each_ms, self.wake_ms, self.pauses, self.timed = each_ms, wake_ms, pauses, timed
        self.frames: list[tuple[float, int]] = []
        """When a frame moved which leg."""
        self.rejected: list[tuple[float, Rejected]] = []
        self.started: set[int] = set()
        """The servos that a frame has started."""
        self.commanded: set[int] = set()
        """The legs that messages named."""
        self._depth = put_depth(50, 250)
        self._step(0, BusOpened())

    def _step(self, at_ms: float, event: object, instant_ms: float | None = None) -> None:
        instant_ns = None if instant_ms is None else _ns(instant_ms)
        for effect in self.supervisor.step(event, _ns(at_ms), instant_ns):  # type: ignore[arg-type]
            if isinstance(effect, Transmit) and not effect.frame.is_stop:
                self.frames.append((at_ms, effect.frame.leg))
                self.started |= {servo for servo, op in effect.frame.servos if op.op is Op.START}
            elif isinstance(effect, Rejected):
                self.rejected.append((at_ms, effect))

    def run(self, arrivals: Iterable[Arrival], until_ms: float) -> "Robot":
        """Deliver these, and let time pass until then."""
        waiting = deque(sorted(arrivals, key=lambda each: each.at_ms))
        now_ms = 0.0
        while True:
            due_ns = self.supervisor.due_ns
            due_ms = until_ms + 1 if due_ns is None else due_ns / NS_PER_MS - START_MS
            came_ms = waiting[0].at_ms + self.wake_ms if waiting else until_ms + 1
            now_ms = self._awake(max(now_ms, min(due_ms, came_ms)))
            if now_ms > until_ms:
                return self
            rings: dict[str, deque[Arrival]] = {}
            while waiting and waiting[0].at_ms <= now_ms:
                each = waiting.popleft()
                rings.setdefault(each.key, deque(maxlen=self._depth)).append(each)
            instant_ms = now_ms
            for key in COMMAND_KEYS:
                newest = [*rings.get(key, ())][-RING_DEPTH:]
                for each in newest:
                    angle = 90_00 + round(each.at_ms) % 1000
                    sent_ms = each.at_ms if self.timed else None
                    targets = targets_of(key, ServoOp(each.op, angle))
                    command = Command(targets, frames=frames_of(targets), key=key, sent_ms=sent_ms)
                    command.verb = each.verb
                    self.commanded |= set(command.by_leg)
                    self._step(now_ms, command, instant_ms)
                    now_ms += self.each_ms
            if not rings or now_ms >= due_ms:
                self._step(now_ms, TimePassed(), instant_ms)

    def _awake(self, at_ms: float) -> float:
        return next((to for begun, to in self.pauses if begun <= at_ms < to), at_ms)


START_MS: Final = 60_000


def _ns(at_ms: float) -> int:
    return round((START_MS + at_ms) * NS_PER_MS)


RULES: Final = f"rules start_wait_ms={START_WAIT_NS / NS_PER_MS}\n"
STAGGERED: Final = RULES.replace("rules", "rules start_pause_ms=50,")
KEYS: Final[dict[str, list[str]]] = {
    "legs": [LEGS_COMMAND],
    "one leg": [leg_command(1)],
    "six legs": [leg_command(leg) for leg in LEGS],
    "a servo": [servo_command(11)],
    "three servos": [servo_command(each) for each in (11, 12, 13)],
    "a servo of each leg": [servo_command(10 * leg + 1) for leg in LEGS],
}
RATES_HZ: Final = [50, 200, 1000, *(pytest.param(each, marks=pytest.mark.full) for each in (100, 150, 300, 500))]
ALL_KEYS: Final = [pytest.param(each, marks=() if each in ("legs", "one leg") else pytest.mark.full) for each in KEYS]
HALF_A_SECOND: Final = 500

# ---- ordinary programs


def stream(
    keys: Sequence[str], rate_hz: float, *, starts: bool, verb: Verb = Verb.PUT, jitter_ms: float = 0.0
) -> Iterator[Arrival]:
    """Yield a second of a program's messages: starts, or a start and then sets."""
    random = Random(rate_hz)  # noqa: S311  (a test's)
    for number in range(round(rate_hz)):
        op = Op.START if starts or number == 0 else Op.SET
        at_ms = max(0.0, number * 1000 / rate_hz + random.uniform(-jitter_ms, jitter_ms))
        yield from (Arrival(at_ms, key, op, verb) for key in keys)


def batched(arrivals: Iterable[Arrival]) -> list[Arrival]:
    """Deliver as Zenoh does without `express` on a busy link: messages within a millisecond leave together."""
    return [each._replace(at_ms=float(-(-each.at_ms // 1))) for each in arrivals]


def runs(robot: Robot) -> None:
    """Demand that each leg that was commanded runs within half a second, with 50 frames a second from then on."""
    legs = {leg for _, leg in robot.frames}
    for leg in legs:
        frames = [at_ms for at_ms, of_leg in robot.frames if of_leg == leg]
        assert frames[0] <= HALF_A_SECOND
        assert len([at_ms for at_ms in frames if at_ms >= HALF_A_SECOND]) >= 0.96 * 50 * (1000 - HALF_A_SECOND) / 1000
    assert robot.commanded == legs


@pytest.mark.parametrize("rate_hz", RATES_HZ)
@pytest.mark.parametrize("keys", ALL_KEYS)
def test_a_stream_runs_within_half_a_second_and_gets_its_frames(keys: str, rate_hz: float) -> None:
    for starts, verb, express, timed in product((True, False), (Verb.PUT, Verb.GET), (True, False), (True, False)):
        arrivals = [*stream(KEYS[keys], rate_hz, starts=starts, verb=verb, jitter_ms=0.2)]
        robot = Robot(Rules(start_wait_ns=START_WAIT_NS), timed=timed)
        runs(robot.run(arrivals if express else batched(arrivals), 1000))


@pytest.mark.parametrize(
    "pauses",
    [
        pytest.param([(5, 25)], id="once, as it starts"),
        pytest.param([(at, at + 15) for at in range(3, 1000, 97)], id="15 ms, ten times a second"),
        pytest.param([(at, at + 5) for at in range(1, 1000, 41)], id="5 ms, 24 times a second"),
    ],
)
@pytest.mark.parametrize("rate_hz", [200, 1000])
@pytest.mark.parametrize("keys", ["one leg", "six legs"])
def test_a_machine_that_is_busy_delays_no_start_beyond_that(
    keys: str, rate_hz: float, pauses: list[tuple[float, float]]
) -> None:
    """The reader finds several messages at once after each pause, as if a link had held them back."""
    for starts in (True, False):
        arrivals = stream(KEYS[keys], rate_hz, starts=starts, jitter_ms=0.2)
        runs(Robot(Rules(start_wait_ns=START_WAIT_NS), pauses=pauses).run(arrivals, 1000))


# ---- what a link has held back


def held_back(keys: Sequence[str], rate_hz: int, stall_ms: int, *, starts: bool) -> Iterator[Arrival]:
    """Yield the messages that a program has sent during a stall."""
    for number in range(rate_hz * stall_ms // 1000):
        op = Op.START if starts or number == 0 else Op.SET
        yield from (Arrival(0, key, op) for key in keys)


@pytest.mark.parametrize("mbit_s", [0, 20, 2, 1])
@pytest.mark.parametrize("keys", ALL_KEYS)
def test_a_dead_programs_backlog_starts_nothing(keys: str, mbit_s: float) -> None:
    """Streams of 50 to 200 Hz, held back for 0.4 to 3 s; 0 Mbit/s: delivered at once."""
    for rate_hz, stall_ms, starts in product((50, 100, 200), (400, 1000, 3000), (True, False)):
        sent = held_back(KEYS[keys], rate_hz, stall_ms, starts=starts)
        robot = Robot(Rules(start_wait_ns=START_WAIT_NS)).run(delivered(sent, mbit_s), 6000)
        assert not robot.frames, (rate_hz, stall_ms, starts)
        assert {each.reason for _, each in robot.rejected} <= {"stale", "servo_stopped"}


@pytest.mark.parametrize(
    "changes",
    [
        {"start_pause_ns": 50 * NS_PER_MS},
        {"takeover_cdeg_s": 180_00},
        {"lease_ttl_ns": 100 * NS_PER_MS},
        {"starts_whole": True},
    ],
    ids=repr,
)
def test_a_backlog_starts_nothing_under_other_rules_either(changes: dict[str, Any]) -> None:
    for mbit_s in (0, 20, 2, 1):
        sent = held_back(KEYS["legs"], 100, 1000, starts=True)
        robot = Robot(Rules(start_wait_ns=START_WAIT_NS, **changes))
        assert not robot.run(delivered(sent, mbit_s), 3000).frames


def test_a_live_stream_after_its_own_backlog_runs_within_half_a_second() -> None:
    late = [*delivered(held_back([leg_command(1)], 50, 1000, starts=True), 2)]
    ends_ms = late[-1].at_ms
    live = [each._replace(at_ms=ends_ms + 20 + each.at_ms) for each in stream([leg_command(1)], 50, starts=True)]
    robot = Robot(Rules(start_wait_ns=START_WAIT_NS)).run([*late, *live], 2000)
    assert ends_ms < robot.frames[0][0] <= ends_ms + 20 + HALF_A_SECOND


FRESH: Final = (servo_command(11), leg_command(1), LEGS_COMMAND)
DELAYED: Final = (servo_command(12), leg_command(1), leg_command(2), LEGS_COMMAND)


@pytest.mark.parametrize(("fresh", "delayed"), [pair for pair in product(FRESH, DELAYED) if pair[0] != pair[1]])
@pytest.mark.parametrize("after_ms", [2, 14, 200])
@pytest.mark.parametrize("mbit_s", [0, 1])
def test_beside_a_fresh_start_on_another_key_a_backlog_starts_nothing(
    fresh: str, delayed: str, after_ms: float, mbit_s: float
) -> None:
    """Once the fresh ones run, they take every command."""
    sent = delivered([Arrival(0, delayed, Op.START)] * 8, mbit_s)
    backlog = [each._replace(at_ms=after_ms + each.at_ms) for each in sent]
    robot = Robot(Rules(start_wait_ns=START_WAIT_NS)).run([Arrival(0, fresh, Op.START), *backlog], 1000)
    its, others = ({servo for servo, _ in targets_of(key, STOP)} for key in (fresh, delayed))
    assert robot.started == (its if backlog[0].at_ms > START_WAIT_NS / NS_PER_MS else its - others)


CLUMPS: Final = "\n".join(f"{at_ms} leg 1 start 90\n{at_ms} leg 1 start 90" for at_ms in range(100, 490, 30))
SCENES: Final = {
    "the newest angle of a stream leaves after 40 ms": f"""{RULES}
        100 leg 1 start 90 → nothing
        110 leg 1 set 80 → completed 1 coalesced
        130 leg 1 set 70 → completed 2 coalesced
        due 140
        140 time → command 1 start 70; completed 3""",
    "of three messages at once the last one starts the leg": f"""{RULES}
        100 leg 1 start 90
        100 leg 1 set 80
        100 leg 1 set 70 → completed 2 coalesced
        139 pass → nothing
        140 time → command 1 start 70; completed 3""",
    "of four messages at once none starts it": f"""{RULES}
        100 leg 1 start 90
        100 leg 1 set 80
        100 leg 1 set 70
        100 leg 1 set 60 → completed 3 coalesced
        139 pass → nothing
        140 time → rejected 4 stale
        due never
        349 leg 1 start 90 → nothing
        388 pass → nothing
        389 time → rejected 5 stale
        599 leg 1 start 90 → nothing  # nothing came for 250 ms
        614 time → command 1 start 90; completed 6""",
    "clumps that go on are rejected after 400 ms": f"""{RULES}
        {CLUMPS}
        490 leg 1 start 90
        490 leg 1 start 90 → completed 27 coalesced
        500 time → rejected 28 stale""",
    "a start leaves as soon as no key that addresses it has a score": f"""{RULES}
        100 legs 12 start 90 (key legs)
        100 legs 12 start 90 (key legs)
        110 legs 2 set 80 (key legs)
        115 time → nothing
        139 legs 2 set 80 (key legs)
        140 time → nothing
        141 legs 2 set 80 (key legs) → completed 4 coalesced; command 2 start 80; completed 5
        141.000001 time → command 1 start 90; completed 2 coalesced""",
    "a start that waits for its judgement keeps no other leg waiting": f"""{STAGGERED}
        100 leg 2 start 90 (key two)
        100 leg 2 start 90 (key two)
        101 timed leg 3 start 90 → command 3 start 90; completed 99""",
    "with staggered starts a Stop of another leg ends it": f"""{STAGGERED}
        100 leg 2 start 90
        101 servo 31 stop (key three) → command 31 stop; completed 2; rejected 1 servo_stopped""",
    "a stop of a clump is a stop": f"""{RULES}
        100 leg 1 start 90
        100 leg 1 start 90
        100 leg 1 start 90 + leg 2 stop → command 2 stop; completed 2 coalesced
        100 leg 1 stop → command 1 stop; completed 3 coalesced; completed 4""",
    "a servo beside one that runs waits, too": f"""{RULES}
        100 servo 11 start 90 (key a)
        115 time → command 11 start 90; completed 1
        120 servo 12 start 80 (key b) → nothing
        120 servo 12 start 80 (key b)
        120 servo 12 start 80 (key b)
        120 servo 12 start 80 (key b)
        159 pass → nothing
        160 time → rejected 5 stale""",
}
test_a_scene = scene_test(SCENES)


def test_a_rejection_ends_with_how_long_to_wait() -> None:
    scenes = play(f"{RULES}\n" + "\n".join(["100 leg 1 start 90"] * 4) + "\n140 time")
    assert scenes.detail.endswith("wait 250 ms")


def test_a_program_that_waits_for_each_answer_runs() -> None:
    """Four sets are rejected, each within 0.3 ms, and then it starts."""
    key = leg_command(1)
    sets = [Arrival(each * 0.3, key, Op.SET, Verb.GET) for each in range(12)]
    robot = Robot(Rules(start_wait_ns=START_WAIT_NS), each_ms=0.05, wake_ms=0.05)
    robot.run([*sets, Arrival(3.6, key, Op.START, Verb.GET)], 300)
    assert [leg for _, leg in robot.frames] == [1]


def test_a_start_that_waits_for_its_judgement_gets_no_power() -> None:
    robot = Robot(Rules(start_wait_ns=START_WAIT_NS, power=True, feed_ns=1800 * NS_PER_MS))
    robot.run(delivered(held_back([leg_command(1)], 100, 1000, starts=True), 0), 30)
    assert robot.supervisor.legs.to_feed() == {}


@pytest.mark.parametrize(("event", "reason"), [(BusFailed("gone"), "bus_fault"), (ShutDown(), "stopping")])
def test_a_start_that_waits_for_its_judgement_ends_with_the_reason_of_what_stops_all(
    event: BusFailed | ShutDown, reason: str
) -> None:
    """The judgement is due at the same time."""
    robot = Robot(Rules(start_wait_ns=START_WAIT_NS))
    robot.run(delivered(held_back([leg_command(1)], 100, 100, starts=True), 0), 30)
    assert robot.supervisor.backlog.held
    effects = robot.supervisor.step(event, _ns(100))
    assert [each.reason for each in effects if isinstance(each, Rejected)] == [reason]
