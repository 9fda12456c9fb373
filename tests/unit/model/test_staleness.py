"""Commands that were delayed: bursts after a stall, drifting clocks, restarts, many sources."""

import asyncio
import math
import re

import pytest

from gateway.model.staleness import CLOCKS, FORGET_MS, SOURCES, STEADY_MS, Staleness
from schemas import keys
from schemas.words import Kind, Reason
from tests.support.robot import MS, leg, servo, started_and_quiet

MAX_AGE_MS = 200.0


class Publisher:
    """Publishes by a clock of its own: an unknown zero, and perhaps another rate."""

    def __init__(
        self, staleness: Staleness, *, name: str | None = "laptop", zero_ms: float = 5e6, ppm: float = 0
    ) -> None:
        self._staleness, self.name, self.zero_ms, self._rate = staleness, name, zero_ms, 1 + ppm * 1e-6

    def clock_ms(self, now_ms: float) -> float:
        return self.zero_ms + now_ms * self._rate

    def arrives(self, now_ms: float, *, sent_at_ms: float | None = None) -> float | None:
        """Return the delay of a command that arrives now, sent now or earlier, if it is rejected for that."""
        said = self.asks(now_ms, sent_at_ms=sent_at_ms)
        if said is None:
            return None
        delayed = re.fullmatch(r"the command was delayed for (\d+) ms; at most 200 are allowed", said)
        assert delayed, said
        return float(delayed[1])

    def asks(self, now_ms: float, *, sent_at_ms: float | None = None) -> str | None:
        """Return why that command is rejected."""
        sent_ms = self.clock_ms(now_ms if sent_at_ms is None else sent_at_ms)
        return self._staleness.too_old(self.name, sent_ms, round(now_ms * MS), round(now_ms * MS))

    def streams(self, begin_ms: float, end_ms: float, *, delay_ms: float = 0.0, period_ms: float = 20.0) -> list[bool]:
        """Return whether each command of a stream is rejected."""
        count = int((end_ms - begin_ms) / period_ms)
        times = [begin_ms + index * period_ms for index in range(count)]
        return [self.arrives(sent_ms + delay_ms, sent_at_ms=sent_ms) is not None for sent_ms in times]


@pytest.fixture
def staleness() -> Staleness:
    """The loop turned all the time, also between the commands of a test."""
    found = Staleness(MAX_AGE_MS)
    found.pause_ms = math.inf
    return found


@pytest.fixture
def laptop(staleness: Staleness) -> Publisher:
    """Return a laptop that has been received for a second."""
    found = Publisher(staleness)
    found.streams(0, 1000)
    return found


@pytest.mark.parametrize("silence_ms", [1e4, 1e6, 3.6e6])
def test_the_burst_is_known_for_one_after_any_silence(laptop: Publisher, silence_ms: float) -> None:
    drift_ms = 200e-6 * silence_ms
    late_ms = laptop.arrives(1000 + silence_ms, sent_at_ms=1000 + silence_ms - drift_ms - MAX_AGE_MS - 5)
    assert late_ms is not None


@pytest.mark.parametrize("ppm", [-100, 100])
def test_a_drifting_clock_is_not_locked_out_in_a_day(staleness: Staleness, ppm: float) -> None:
    publisher = Publisher(staleness, ppm=ppm)
    assert not any(publisher.streams(0, 86_400_000, period_ms=1000))


def test_drift_does_not_hide_a_delay(staleness: Staleness) -> None:
    publisher = Publisher(staleness, ppm=-100)
    publisher.streams(0, 3_600_000, period_ms=100)
    assert publisher.arrives(3_600_300, sent_at_ms=3_600_000) is not None


@pytest.mark.parametrize("first_ms", [700, 1000], ids=["steady", "grows once"])
def test_a_way_that_has_become_slower_for_good_is_the_new_baseline_after_five_seconds(
    laptop: Publisher, first_ms: float
) -> None:
    assert all(laptop.streams(1000, 2000, delay_ms=first_ms))
    rejected = laptop.streams(2000, 12_000, delay_ms=1000 if first_ms == 700 else 700)
    assert sum(rejected) * 20 == pytest.approx(STEADY_MS, abs=40)
    assert not any(rejected[260:])
    now_delayed = 905 + (300 if first_ms == 700 else 0)
    assert laptop.arrives(20_000, sent_at_ms=20_000 - now_delayed) == pytest.approx(205, abs=3)


@pytest.mark.parametrize(("apart_ms", "becomes_steady"), [(1000, True), (1001, False)])
def test_a_steady_delay_is_one_that_is_heard_each_second(
    laptop: Publisher, apart_ms: float, becomes_steady: bool
) -> None:
    rejected = laptop.streams(1000, 1000 + 7 * apart_ms, delay_ms=700, period_ms=apart_ms)
    assert rejected == [True] * 5 + [not becomes_steady] * 2


@pytest.mark.parametrize(("spread_ms", "becomes_steady"), [(200, True), (201, False)])
def test_a_steady_delay_varies_by_no_more_than_what_is_allowed(
    laptop: Publisher, spread_ms: float, becomes_steady: bool
) -> None:
    late = [
        laptop.arrives(sent_ms + 700 + spread_ms * (sent_ms % 1000 != 0), sent_at_ms=sent_ms) is not None
        for sent_ms in range(1000, 7000, 500)
    ]
    assert all(late[:10])
    assert late[-1] is not becomes_steady


@pytest.mark.parametrize(("behind_ms", "late_ms"), [(20_000, 20_000), (20_001, None)])
def test_what_is_out_of_order_is_an_old_one_where_a_link_can_have_held_it(
    staleness: Staleness, behind_ms: float, late_ms: float | None
) -> None:
    publisher = Publisher(staleness)
    publisher.streams(0, 40_000)
    assert publisher.arrives(40_000) is None
    assert publisher.arrives(40_000, sent_at_ms=40_000 - behind_ms) == late_ms


@pytest.mark.parametrize(("ahead_ms", "late_ms"), [(50, 210), (51, None)])
def test_a_baseline_falls_by_a_quarter_of_what_is_allowed_and_beyond_that_it_is_another_clock(
    staleness: Staleness, ahead_ms: float, late_ms: float | None
) -> None:
    publisher = Publisher(staleness)
    assert publisher.arrives(1000) is None
    assert publisher.arrives(1000, sent_at_ms=1000 + ahead_ms) is None
    assert publisher.arrives(1000, sent_at_ms=1000 - 160) == late_ms


@pytest.mark.parametrize(("sent_at_ms", "late_ms"), [(1979, 600), (1980, None)])
def test_a_clock_keeps_its_baseline_where_a_late_command_overtook_another_since_there_may_be_two(
    laptop: Publisher, sent_at_ms: float, late_ms: float | None
) -> None:
    assert all(laptop.streams(1000, 2000, delay_ms=700))
    assert laptop.arrives(2690, sent_at_ms=sent_at_ms) is not None, "the newest was sent at 1980 ms"
    assert laptop.streams(2000, 8000, delay_ms=700)[-50:] == [False] * 50
    assert laptop.arrives(9000, sent_at_ms=8400) == (late_ms and pytest.approx(late_ms, abs=3))


def test_a_clock_that_has_a_new_baseline_is_the_one_heard_last(staleness: Staleness) -> None:
    slower, ahead = Publisher(staleness), Publisher(staleness, zero_ms=5e6 + 600)
    slower.streams(0, 1000)
    assert all(slower.streams(1000, 6000, delay_ms=700))
    assert ahead.arrives(6690) is None
    assert slower.arrives(6700, sent_at_ms=6000) is None
    assert slower.arrives(8300, sent_at_ms=7300) == pytest.approx(300, abs=3), "by the other's clock 1600 ms"


def test_stalls_again_and_again_never_pass_for_a_steady_way(staleness: Staleness) -> None:
    publisher = Publisher(staleness)
    for now_ms in range(1000, 20_000, 720):
        assert publisher.arrives(now_ms, sent_at_ms=now_ms) is None
        assert publisher.arrives(now_ms + 710, sent_at_ms=now_ms + 10) is not None or now_ms == 1000


@pytest.mark.parametrize("begun_ms", [0, 3_600_000])
def test_a_source_is_forgotten_only_after_a_minute_of_silence(staleness: Staleness, begun_ms: float) -> None:
    first = Publisher(staleness, name="first")
    first.streams(begun_ms, begun_ms + 100)
    others = [Publisher(staleness, name=f"source {number}", zero_ms=number) for number in range(SOURCES)]
    said = [other.asks(begun_ms + 100) for other in others]
    assert said[:-1] == [None] * (SOURCES - 1)
    assert said[-1] is not None
    assert re.fullmatch(
        r"256 sources have sent commands within 60 s, more than .* wait, or leave out sent_ms", said[-1]
    )
    assert first.arrives(begun_ms + 1300, sent_at_ms=begun_ms + 1000) is not None, "its burst is known for one"
    assert others[-1].asks(begun_ms + 100 + FORGET_MS) is None, "one of the silent ones is forgotten"
    assert len(staleness._sources) == SOURCES
    assert first.arrives(begun_ms + 100 + FORGET_MS, sent_at_ms=begun_ms + FORGET_MS - 200) is not None


# ---- several clocks behind one name: forgers, programs of one name, restarts


def test_a_clock_that_is_pushed_ahead_little_by_little_does_not_lock_its_owner_out(
    staleness: Staleness, laptop: Publisher
) -> None:
    for ahead_ms in range(40, 4000, 40):
        Publisher(staleness, zero_ms=5e6 + ahead_ms).asks(1000)
    assert not any(laptop.streams(1001, 9000))


@pytest.mark.parametrize("ahead_ms", [600, 19_000, 3_600_000, -21_000, -3_600_000])
def test_beside_a_forged_clock_the_owners_burst_is_still_known_for_one(staleness: Staleness, ahead_ms: float) -> None:
    owner, forger = Publisher(staleness), Publisher(staleness, zero_ms=5e6 + ahead_ms)
    owner.streams(0, 6000)
    forger.asks(6001)
    owner.streams(6002, 7000)
    burst = [owner.arrives(10_000 + index * 0.01, sent_at_ms=7000 + index * 20) for index in range(130)]
    assert all(late is not None for late in burst)


def test_a_new_clock_takes_the_place_of_the_proven_one_that_is_silent_for_longest(staleness: Staleness) -> None:
    *proven, new = (Publisher(staleness, zero_ms=number * 1e6) for number in range(CLOCKS + 1))
    for begin_ms, publisher in zip(range(0, 54_000, 6000), (*proven, proven[0]), strict=True):
        publisher.streams(begin_ms, begin_ms + 6000)
    assert new.arrives(54_000) is None
    assert proven[0].arrives(55_000, sent_at_ms=54_400) is not None
    assert proven[1].arrives(55_000, sent_at_ms=54_400) is None, "as a clock that nobody knows"


def test_an_old_command_out_of_order_between_two_clocks_is_judged_by_the_one_heard_last(staleness: Staleness) -> None:
    behind, ahead = Publisher(staleness), Publisher(staleness, zero_ms=5e6 + 600)
    for index in range(300):
        assert behind.arrives(index * 20) is None
        assert ahead.arrives(index * 20 + 10) is None
    assert ahead.arrives(6000, sent_at_ms=5350) is not None, "50 ms old by the other's clock"


@pytest.mark.parametrize(
    ("apart_ms", "delay_ms", "late_ms", "later_ms"),
    [
        (600, 200, None, 250),  # just fresh by the one heard for longest
        (600, 201, 801, 850),
        (100, 100, None, 350),  # just fresh by the one heard last, which is believed first
    ],
)
def test_of_two_clocks_the_one_heard_last_is_believed_and_then_the_one_heard_for_longest(
    staleness: Staleness, apart_ms: float, delay_ms: float, late_ms: float | None, later_ms: float
) -> None:
    behind, ahead = Publisher(staleness), Publisher(staleness, zero_ms=5e6 + apart_ms)
    said = [
        staleness.too_old(publisher.name, publisher.clock_ms(now_ms - before_ms), now_ms * MS, 1000 * MS)
        for publisher, now_ms, before_ms in (
            *((behind, 1000, 0), (behind, 1010, 0), (ahead, 1020, 0)),
            *((behind, 2000, delay_ms), (behind, 2001, 250)),
        )
    ]
    delays = [None if why is None else float(why.split()[5]) for why in said]
    assert delays == [None, None, None, late_ms, later_ms]


# ---- commands that may have waited in a gateway that was stopped itself; and what the gateway says to delayed ones


@pytest.fixture
def stopping() -> Staleness:
    """Return one whose loop turns when the test asks for it."""
    return Staleness(MAX_AGE_MS)


def turn_until(staleness: Staleness, now_ms: float) -> None:
    for turn_ms in range(0, round(now_ms), 100):
        staleness.record_alive(turn_ms * MS)


def without_sent_ms(staleness: Staleness, now_ms: float) -> str | None:
    return staleness.too_old("anybody", None, round(now_ms * MS), round(now_ms * MS))


def test_after_a_pause_of_its_own_only_what_is_known_to_be_fresh_is_taken(stopping: Staleness) -> None:
    known, stranger = Publisher(stopping), Publisher(stopping, name="stranger", zero_ms=0)
    turn_until(stopping, 1000)
    assert known.asks(990) is None
    assert without_sent_ms(stopping, 990) is None
    stopping.record_alive(3000 * MS)
    assert known.arrives(3000, sent_at_ms=1500) is not None
    assert known.asks(3001) is None, "its clock says that it is fresh"
    for at_ms in (3001, 3100, 3199):
        said = stranger.asks(at_ms)
        assert said == without_sent_ms(stopping, at_ms)
        assert said == (
            "the gateway itself was stopped for 2010 ms, so the command may have waited in it; for 200 ms only those "
            "are accepted whose sent_ms shows that they are fresh"
        )
    assert stranger.asks(3201) is None
    assert without_sent_ms(stopping, 3201) is None


def test_the_usual_turns_of_the_loop_are_no_pause(stopping: Staleness) -> None:
    for now_ms in (0, 100, 350, 550, 800):
        stopping.record_alive(now_ms * MS)
        assert without_sent_ms(stopping, now_ms) is None
    stopping.record_alive(1051 * MS)
    assert without_sent_ms(stopping, 1051) is not None


def test_a_pause_that_is_not_longer_than_what_a_command_may_be_delayed_is_none() -> None:
    staleness = Staleness(2000)
    for now_ms in (0, 2000, 4000):
        staleness.record_alive(now_ms * MS)
        assert without_sent_ms(staleness, now_ms) is None
    staleness.record_alive(6001 * MS)
    assert without_sent_ms(staleness, 8001) is not None
    assert without_sent_ms(staleness, 8002) is None


# ---- in the gateway


@pytest.mark.virtual_time
async def test_the_gateway_rejects_what_was_delayed_but_never_a_stop() -> None:
    robot = await started_and_quiet(limits={"max_age_ms": MAX_AGE_MS})
    key = keys.servo_command(32)
    assert robot.ask(key, servo("start", 90, source="laptop", sent_ms=1000)).accepted
    await asyncio.sleep(0.05)
    await asyncio.sleep(0.45)  # half a second after the first
    ack = robot.ask(key, servo("set", 80, source="laptop", sent_ms=1001))
    assert ack.reason == Reason.STALE
    assert ack.detail == "the command was delayed for 499 ms; at most 200 are allowed"
    mixed = leg("start", 1, 2, 3, source="laptop", sent_ms=1001)
    assert robot.ask(keys.leg_command(3), mixed).reason == Reason.STALE
    assert robot.ask(key, servo("start", 80)).accepted, "nothing is known of a command without sent_ms"
    assert robot.ask(key, servo("stop", source="laptop", sent_ms=1001)).accepted
    assert robot.controller.energised == set()


@pytest.mark.virtual_time
@pytest.mark.parametrize("between", ["ticks", "messages"])
async def test_a_gateway_that_was_stopped_itself_does_not_execute_what_waited_in_it(between: str) -> None:
    robot = await started_and_quiet(watchdog={"timeout_ms": 10_000})
    key = keys.leg_command(3)
    assert robot.ask(key, leg("start", 1, 2, 3, source="laptop", sent_ms=1000)).accepted
    if between == "ticks":
        robot.sleep_through(2)
    else:
        robot.put_later(keys.leg_command(1), leg("stop"))
        robot.each_takes_ns = 2000 * MS
    robot.put_later(key, leg("set", 4, 5, 6, source="laptop", sent_ms=1010))
    robot.put_later(keys.leg_command(2), leg("start", 4, 5, 6))
    robot.put_later(keys.RESET, {"estop": 0})
    robot.conductor.tick()
    robot.each_takes_ns = 0
    assert robot.controller.energised == {31, 32, 33}
    assert [event.reason for event in robot.events(Kind.COMMAND_REJECTED)] == [Reason.STALE] * 3
    assert robot.ask(keys.leg_command(2), leg("start", 4, 5, 6)).reason == Reason.STALE
    assert robot.ask(key, leg("stop")).accepted
    assert robot.ask(keys.ESTOP).stop_frames == 6
    await asyncio.sleep(0.6)
    assert robot.ask(keys.RESET, {"estop": 1}).accepted
    assert robot.ask(keys.leg_command(2), leg("start", 4, 5, 6)).accepted
