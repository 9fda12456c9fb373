"""A model of deliveries between the reads of rings: each moment at which two messages of one session may arrive.

The rings and the supervisor are the real ones; Zenoh is replaced by lists, filled at a chosen read of any ring.
"""

import itertools
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import NamedTuple

import pytest

from gateway.model.frames import STOP, Op, ServoOp, servo_ids_of
from gateway.robot.core.events import BusOpened, Command, Transmit
from gateway.robot.core.message import Verb
from gateway.robot.core.rules import Rules
from gateway.robot.core.supervisor import Supervisor
from gateway.robot.zenoh_io.rings import LEAST_PUT_DEPTH, PASSES, RING_DEPTH, Rings
from schemas.keys import COMMAND_KEYS, ESTOP, LEGS_COMMAND, RESET, leg_command, servo_command

START = ServoOp(Op.START, 90_00)
LEG, SERVO = leg_command(1), servo_command(11)
KEYS = (LEGS_COMMAND, LEG, SERVO)
UNRELATED = leg_command(2)
WAYS = [(key, verb) for key in KEYS for verb in ("put", "get")]
TARGETS = {LEGS_COMMAND: servo_ids_of(1), LEG: servo_ids_of(1), SERVO: (11,)}


class Message(NamedTuple):
    """`op` for each of these servos, by a key and verb."""

    key: str
    verb: str
    op: ServoOp
    servos: tuple[int, ...]

    @property
    def words_of_stop(self) -> bytes | None:
        return str(self).encode() if self.op is STOP else None


def message(way: tuple[str, str], op: ServoOp) -> Message:
    """Return a message of the session that may name leg 1."""
    return Message(*way, op, TARGETS[way[0]])


@dataclass
class Deliveries:
    """Fills rings while they are read: messages in their order, each before the read that is chosen for it."""

    due: deque[tuple[int, Message]]
    flood: Callable[[str, str], Message | None] = lambda _key, _verb: None
    """What arrives in a ring each time that it was found empty."""
    depth: int = LEAST_PUT_DEPTH
    """The depth of a ring of puts."""
    reads: int = 0
    rings: dict[tuple[str, str], deque[Message]] = field(default_factory=dict)

    def receiver(self, key: str, verb: str) -> Callable[[], Message | None]:
        ring = self.rings.setdefault((key, verb), deque(maxlen=self.depth if verb == "put" else RING_DEPTH))

        def receive() -> Message | None:
            while self.due and self.due[0][0] <= self.reads:
                arriving = self.due.popleft()[1]
                self.rings[arriving.key, arriving.verb].append(arriving)
            self.reads += 1
            taken = ring.popleft() if ring else None
            more = self.flood(key, verb)
            if taken is None and more is not None:
                ring.append(more)
            return taken

        return receive


class ReadRings:
    """Rings and the supervisor that is given what they hold: a tick is an instant, unless the last is still open."""

    def __init__(self, deliveries: Deliveries, keys: Iterable[str] = KEYS) -> None:
        self.rings = Rings[Message, Message](
            {key: (deliveries.receiver(key, "put"), deliveries.receiver(key, "get")) for key in keys},
            lambda _, item: item,
            lambda item: item.words_of_stop,
            deliveries.depth,
        )
        self.supervisor = Supervisor(Rules(repeats=0, period_ns=1))
        self.supervisor.step(BusOpened(), 0)
        self._now_ns = self._instant_ns = 0
        self.sent: list[ServoOp] = []
        """What servo 11 was told."""

    def tick(self, keys: tuple[str, ...] = ()) -> None:
        self._now_ns += 1000
        if not self.rings.instant_open:
            self._instant_ns = self._now_ns
        for key, item in self.rings.read(keys):
            assert item is not None, "nothing was lost"
            command = Command(tuple((each, item.op) for each in item.servos), key=key, verb=Verb(item.verb))
            for effect in self.supervisor.step(command, self._now_ns, self._instant_ns):
                if isinstance(effect, Transmit):
                    self.sent += [op for servo_id, op in effect.frame.servos if servo_id == 11]

    @property
    def running(self) -> bool:
        return self.supervisor.legs.servos[11].running


def stops_by(*ways: tuple[str, str], count: int) -> Callable[[], Callable[[str, str], Message | None]]:
    """Put somebody else's Stops of joint 3: so many in each of these rings, one each time that it was found empty."""

    def flood() -> Callable[[str, str], Message | None]:
        left = dict.fromkeys(ways, count)

        def more(key: str, verb: str) -> Message | None:
            if not left.get((key, verb)):
                return None
            left[key, verb] -= 1
            return Message(key, verb, STOP, (13,))

        return more

    return flood


FLOODS = {
    "alone": stops_by(count=0),
    "beside Stops on one key": stops_by((LEG, "put"), count=9),
    "beside Stops on two keys": stops_by((LEG, "put"), (LEGS_COMMAND, "put"), count=9),
    "beside Stops on one key by both verbs": stops_by((SERVO, "put"), (SERVO, "get"), count=9),
}
CROSSED = [
    ((LEG, "put"), (SERVO, "put")),
    ((SERVO, "put"), (LEGS_COMMAND, "get")),
    ((LEGS_COMMAND, "put"), (LEG, "put")),
]


@pytest.mark.parametrize(
    ("flood", "first_tick"),
    [
        *(("alone", first) for first in [(), (SERVO,), (LEG,), (LEGS_COMMAND,)]),
        *((flood, first) for flood in FLOODS for first in [(SERVO,)] if flood != "alone"),
    ],
)
def test_no_start_overtakes_a_stop_whenever_the_two_arrive(flood: str, first_tick: tuple[str, ...]) -> None:
    """Whichever wakeup is heard first: all others may still be with the thread that waits for them."""
    seen = 0
    alone = flood == "alone"
    pairs = list(itertools.product(WAYS, WAYS)) if alone else CROSSED
    for start, stop in pairs:
        for arrivals in itertools.combinations_with_replacement(range(14 if alone else 40), 2):
            sent = (message(start, START), message(stop, STOP))
            robot = ReadRings(
                deliveries := Deliveries(deque(zip(arrivals, sent, strict=True)), FLOODS[flood]()), (*KEYS, UNRELATED)
            )
            robot.tick(first_tick)
            while deliveries.due or any(deliveries.rings.values()):
                robot.tick((UNRELATED,))
                robot.tick(first_tick)
                robot.tick()
            assert not robot.running, f"{start} then {stop}, arriving before reads {arrivals}: {robot.sent}"
            assert START not in robot.sent or STOP in robot.sent[robot.sent.index(START) :]
            seen += START in robot.sent
    assert seen, "in some orders the Start takes effect before the Stop"


def taken(messages: tuple[Message, Message], arrivals: tuple[int, ...], first_tick: str) -> list[str]:
    """Return the keys of two messages in the order of handling. The first tick received only this wakeup."""
    robot = ReadRings(deliveries := Deliveries(deque(zip(arrivals, messages, strict=True))), (*KEYS, RESET))
    order = [key for key, _ in robot.rings.read([first_tick])]
    while deliveries.due or any(deliveries.rings.values()):
        order += [key for key, _ in robot.rings.read()]
    return order


ARRIVALS = list(itertools.combinations_with_replacement(range(14), 2))


def test_what_was_sent_before_a_reset_is_taken_before_it() -> None:
    """A start that was sent while the emergency stop was engaged must not come after the reset."""
    messages = (message((LEG, "put"), START), Message(RESET, "get", STOP, ()))
    assert all(taken(messages, arrivals, RESET) == [LEG, RESET] for arrivals in ARRIVALS)


@pytest.mark.parametrize(
    ("ways", "op", "stays_open"),
    [
        ([(LEG, "put")], STOP, False),
        ([(LEG, "put"), (LEGS_COMMAND, "put")], STOP, True),
        ([(LEG, "put"), (LEG, "get")], STOP, True),
        ([(LEG, "put"), (LEGS_COMMAND, "put"), (SERVO, "get")], ServoOp(Op.SET, 1), False),
        ([(leg_command(2), "put"), (LEG, "put")], STOP, False),
        ([(RESET, "put"), (RESET, "get")], STOP, False),
        ([(key, verb) for key in COMMAND_KEYS for verb in ("put", "get")], ServoOp(Op.SET, 1), False),
    ],
)
def test_only_floods_of_stops_on_keys_that_share_servos_keep_an_instant_open(
    ways: list[tuple[str, str]], op: ServoOp, stays_open: bool
) -> None:
    flood_ends = False

    def flood(key: str, verb: str) -> Message | None:
        return Message(key, verb, op, (13,)) if (key, verb) in ways and not flood_ends else None

    deliveries = Deliveries(deque(), flood)
    robot = ReadRings(deliveries, [key for key in COMMAND_KEYS if key != ESTOP])
    for _ in range(5):
        robot.rings.read()
        before = deliveries.reads
        robot.rings.read([LEG])
        assert robot.rings.instant_open is stays_open
        assert deliveries.reads - before <= (PASSES + 1) * 2 * len(COMMAND_KEYS), "a tick's work has a bound"
    flood_ends = True
    robot.rings.read()
    assert not robot.rings.instant_open


def thinned(
    waiting: list[tuple[ServoOp, int]], verb: str = "put", depth: int = LEAST_PUT_DEPTH
) -> list[Message | None]:
    """Return what is taken of one ring in which these operations for one servo wait."""
    due = deque((0, Message(LEG, verb, op, (servo_id,))) for op, servo_id in waiting)
    return [item for _, item in ReadRings(Deliveries(due, depth=depth)).rings.read([LEG])]


@pytest.mark.parametrize(
    ("before", "depth"), [(0, LEAST_PUT_DEPTH), (LEAST_PUT_DEPTH - RING_DEPTH - 3, LEAST_PUT_DEPTH), (47, 58)]
)
def test_of_older_messages_the_stops_are_taken_before_the_newest(before: int, depth: int) -> None:
    """Until a ring is full, however deep it is."""
    older = [(START, 12)] * before + [(STOP, 11)] + [(START, 13)]
    newest = [(START, number) for number in range(RING_DEPTH)]
    taken = [(item.op, *item.servos) for item in thinned(older + newest, depth=depth) if item is not None]
    assert taken == [(STOP, 11), *newest]


@pytest.mark.parametrize(("lost", "depth"), [(0, LEAST_PUT_DEPTH), (100, LEAST_PUT_DEPTH), (1, 58)])
def test_a_full_ring_may_have_lost_a_stop(lost: int, depth: int) -> None:
    messages = thinned([(STOP, 11)] * lost + [(START, 13)] * depth, depth=depth)
    assert messages[0] is None
    assert len(messages) == 1 + RING_DEPTH


def test_a_get_that_is_lost_is_not_answered_and_stops_nothing() -> None:
    assert None not in thinned([(START, 13)] * 100, "get")


@pytest.mark.parametrize("count", [1, RING_DEPTH, RING_DEPTH + 1, 30, 57])
def test_what_newer_messages_displace_is_counted(count: int) -> None:
    """Of equal Stops the last one is kept; all others that are not returned are passed over."""
    for items in ([(START, 13)] * count, [(STOP, 11)] * count):
        due = deque((0, Message(LEG, "put", op, (servo_id,))) for op, servo_id in items)
        rings = ReadRings(Deliveries(due, depth=58)).rings
        assert len(rings.read([LEG])) + rings.passed_over == count
