"""Commands that were held up: bursts after a stall, drifting clocks, restarts, many sources."""

import asyncio

import pytest

from gateway.staleness import SOURCES, STEADY_MS, Staleness
from schemas import keys
from schemas.telemetry import Reason
from tests.robot import leg, servo, started_and_quiet

MAX_AGE_MS = 200.0
MS = 1_000_000


class Publisher:
    """Publishes by a clock of its own: an unknown zero, and perhaps another rate."""

    def __init__(
        self, staleness: Staleness, *, name: str | None = "laptop", zero_ms: float = 5e6, ppm: float = 0
    ) -> None:
        self._staleness, self.name, self.zero_ms, self._rate = staleness, name, zero_ms, 1 + ppm * 1e-6

    def clock_ms(self, now_ms: float) -> float:
        return self.zero_ms + now_ms * self._rate

    def arrives(self, now_ms: float, *, sent_at_ms: float | None = None) -> float | None:
        """A command that arrives now, sent now or earlier; how long it was held up, if it is refused for that."""
        sent_ms = self.clock_ms(now_ms if sent_at_ms is None else sent_at_ms)
        return self._staleness.held_up_ms(self.name, sent_ms, round(now_ms * MS))

    def streams(self, begin_ms: float, end_ms: float, *, delay_ms: float = 0.0, period_ms: float = 20.0) -> list[bool]:
        """Whether each command of a stream is refused."""
        count = int((end_ms - begin_ms) / period_ms)
        times = [begin_ms + index * period_ms for index in range(count)]
        return [self.arrives(sent_ms + delay_ms, sent_at_ms=sent_ms) is not None for sent_ms in times]


@pytest.fixture
def staleness() -> Staleness:
    return Staleness(MAX_AGE_MS)


def test_a_burst_after_a_stall_is_refused_until_it_is_fresh(staleness: Staleness) -> None:
    publisher = Publisher(staleness)
    assert not any(publisher.streams(0, 1000))
    burst = [publisher.arrives(4000 + index * 0.01, sent_at_ms=1000 + index * 20) for index in range(150)]
    ages_ms = [3000 - index * 19.99 for index in range(150)]
    assert all(late is not None for late, age_ms in zip(burst, ages_ms, strict=True) if age_ms > MAX_AGE_MS + 2)
    assert all(late is None for late, age_ms in zip(burst, ages_ms, strict=True) if age_ms < MAX_AGE_MS - 2)
    assert burst[0] == pytest.approx(3000, abs=2)
    assert not any(publisher.streams(4002, 5000))


@pytest.mark.parametrize("silence_ms", [1e4, 1e6, 3.6e6])
def test_the_burst_is_known_for_one_after_any_silence(staleness: Staleness, silence_ms: float) -> None:
    publisher = Publisher(staleness)
    publisher.streams(0, 1000)
    drift_ms = 200e-6 * silence_ms
    late_ms = publisher.arrives(1000 + silence_ms, sent_at_ms=1000 + silence_ms - drift_ms - MAX_AGE_MS - 5)
    assert late_ms is not None


def test_jitter_below_the_limit_passes(staleness: Staleness) -> None:
    publisher = Publisher(staleness)
    delays_ms = [0, 150, 3, 199, 0, 180] * 50
    assert all(
        publisher.arrives(index * 20 + delay_ms, sent_at_ms=index * 20) is None
        for index, delay_ms in enumerate(delays_ms)
    )


@pytest.mark.parametrize("ppm", [-100, 100])
def test_a_drifting_clock_is_not_locked_out_in_a_day(staleness: Staleness, ppm: float) -> None:
    publisher = Publisher(staleness, ppm=ppm)
    assert not any(publisher.streams(0, 86_400_000, period_ms=1000))


def test_drift_does_not_hide_a_delay(staleness: Staleness) -> None:
    publisher = Publisher(staleness, ppm=-100)
    publisher.streams(0, 3_600_000, period_ms=100)
    assert publisher.arrives(3_600_300, sent_at_ms=3_600_000) is not None


@pytest.mark.parametrize("zero_ms", [0.0, -3_000_000.0, 4.9e6])
def test_a_publisher_whose_clock_jumps_back_is_not_locked_out(staleness: Staleness, zero_ms: float) -> None:
    publisher = Publisher(staleness)
    publisher.streams(0, 10_000)
    publisher.zero_ms = zero_ms
    assert not any(publisher.streams(60_000, 61_000))


def test_a_program_with_its_own_zero_that_restarts_early_is_locked_out_for_five_seconds_at_most(
    staleness: Staleness,
) -> None:
    publisher = Publisher(staleness, zero_ms=0)
    publisher.streams(0, 800)
    publisher.zero_ms = -60_000
    refused = publisher.streams(60_000, 70_000)
    assert sum(refused) * 20 == pytest.approx(STEADY_MS, abs=40)
    assert not any(refused[260:])


def test_a_queue_that_empties_slowly_never_passes_for_a_steady_way(staleness: Staleness) -> None:
    publisher = Publisher(staleness)
    publisher.streams(0, 1000)
    # 30 s of commands come through in 20 s: each arrives a little less late than the one before.
    refused = []
    for index in range(1500):
        sent_ms = 1000 + index * 20
        arrival_ms = 31_000 + index * 20 * 2 / 3
        refused.append((publisher.arrives(arrival_ms, sent_at_ms=sent_ms) is not None, arrival_ms - sent_ms))
    assert all(was_refused for was_refused, age_ms in refused if age_ms > MAX_AGE_MS + 20)


def test_bursts_with_pauses_between_them_never_pass_for_a_steady_way(staleness: Staleness) -> None:
    publisher = Publisher(staleness)
    publisher.streams(0, 1000)
    assert all(
        publisher.arrives(10_000 + index * 2000, sent_at_ms=5000 + index * 2000) is not None for index in range(10)
    )


def test_commands_of_one_instant_may_come_in_any_order(staleness: Staleness) -> None:
    publisher = Publisher(staleness)
    publisher.streams(0, 1000)
    # After a stall the keys' rings are read one after the other: leg 1's newest, then leg 2's older ones.
    assert publisher.arrives(9000, sent_at_ms=8990) is None
    assert publisher.arrives(9000, sent_at_ms=2000) is not None


def test_sources_do_not_disturb_each_other(staleness: Staleness) -> None:
    first, second = Publisher(staleness, name="a"), Publisher(staleness, name="b", zero_ms=0)
    for begin_ms in range(0, 1000, 100):
        assert not any(first.streams(begin_ms, begin_ms + 100))
        assert not any(second.streams(begin_ms, begin_ms + 100))
    assert first.arrives(3000, sent_at_ms=1000) is not None
    assert second.arrives(3000) is None


def test_sources_are_bounded_and_the_longest_silent_one_is_forgotten(staleness: Staleness) -> None:
    first = Publisher(staleness, name="first")
    first.streams(0, 100)
    for number in range(SOURCES - 1):
        Publisher(staleness, name=f"source {number}").streams(100, 120)
    assert first.arrives(1200, sent_at_ms=1000) is None
    assert first.arrives(1300, sent_at_ms=1000) is not None
    Publisher(staleness, name="one too many").streams(1300, 1320)
    assert first.arrives(1400, sent_at_ms=1000) is not None, "it was heard, so another one is forgotten"


@pytest.mark.virtual_time
async def test_the_gateway_refuses_what_was_held_up_but_never_a_stop() -> None:
    robot = await started_and_quiet(limits={"max_age_ms": MAX_AGE_MS})
    key = keys.servo_command(32)
    assert robot.ask(key, servo("start", 90, source="laptop", sent_ms=1000)).accepted
    await asyncio.sleep(0.05)
    held_up = {"received_ns": robot.now_ns() + 450 * MS}  # half a second after the first
    ack = robot.ask(key, servo("set", 80, source="laptop", sent_ms=1001), **held_up)
    assert ack.reason == Reason.STALE
    assert ack.detail == "the command was held up for 499 ms; at most 200 are allowed"
    assert robot.ask(key, servo("set", 80), **held_up).accepted, "nothing is known of a command without sent_ms"
    mixed = leg("start", 1, 2, 3, source="laptop", sent_ms=1001)
    assert robot.ask(keys.leg_command(3), mixed, **held_up).reason == Reason.STALE
    assert robot.ask(key, servo("stop", source="laptop", sent_ms=1001), **held_up).accepted
    assert robot.controller.energised == set()
