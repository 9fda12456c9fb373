"""What is sent to the power board, and what counts as confirmed: against the simulated board, in virtual time."""

import pytest

from gateway.allowance import NS_PER_MS
from gateway.model.power_board import (
    ALL,
    ASK_CURRENTS,
    CanFrame,
)
from gateway.robot.power.board import News
from gateway.robot.power.offs import Confirmed
from schemas.telemetry import Kind
from tests.support.power_link import ALL_SERVOS, FLIGHT_NS, NONE, Link, fed

ROUND_TRIP_MS = 2 * FLIGHT_NS / NS_PER_MS


# ---- off


def test_an_emergency_stop_leaves_at_once_and_is_confirmed_at_the_boards_pace() -> None:
    link = fed()
    at_ns = link.now_ns
    link.cut()
    link.when_off(ALL_SERVOS, token=7)
    assert not link.ours.confirmed
    link.run(0.3)
    assert link.masks(at_ns) == [(0, 0)]
    assert link.fed() == NONE
    link.run(200)
    [(_, confirmed)] = link.news
    assert isinstance(confirmed, Confirmed)
    assert (confirmed.token, confirmed.confirmed) == (7, True)
    assert confirmed.ms is not None
    assert 25 * 1.5 <= confirmed.ms <= 27 * 1.5 + ROUND_TRIP_MS
    assert link.ours.confirmed
    # One repeat, and none once it is confirmed.
    assert [mask for _, mask in link.masks(at_ns)] == [0, 0]


def test_it_is_repeated_every_20_ms_for_3_s_and_reported_once() -> None:
    link = fed()
    link.cable = False
    at_ns = link.now_ns
    link.cut()
    link.when_off(ALL_SERVOS, token=1)
    link.run(4000)
    masks = link.masks(at_ns)
    assert [ms for ms, _ in masks] == [20 * n for n in range(150)]
    assert {mask for _, mask in masks} == {0}
    unconfirmed = [(at_ns, item.detail) for at_ns, item in link.events(Kind.POWER_UNCONFIRMED)]
    assert [detail for _, detail in unconfirmed] == [
        "the power board does not answer",
        "the power board has not confirmed that these are off",
    ]
    assert [round((each_ns - at_ns) / NS_PER_MS) for each_ns, _ in unconfirmed] == [pytest.approx(100, abs=12), 150]
    assert list(link.confirmations()) == [Confirmed(1, False, None)]
    # The board comes back: its mask leaves at once, for the next 3 s.
    link.cable = True
    link.run(100)
    assert link.ours.confirmed
    assert link.fed() == NONE


def test_streams_of_stops_are_each_confirmed() -> None:
    """One servo each 7 ms: each mask sends those before again, and an answer confirms all that reached the board."""
    link = fed()
    wanted = ALL_SERVOS
    for token, servo in enumerate(sorted(ALL_SERVOS)):
        wanted -= {servo}
        link.want(wanted)
        link.when_off(frozenset({servo}), token)
        link.run(7)
    link.run(200)
    assert sorted(confirmed.token for confirmed in link.confirmations() if confirmed.confirmed) == list(range(18))


# ---- on


@pytest.mark.parametrize("pass_us", [1000, 1500, 2000])
def test_an_on_that_follows_an_answer_is_never_230_passes_late(pass_us: int) -> None:
    """Whenever it is wanted: the counter's quirk would hold it for 230 passes more."""
    assert max(second_on_ms(pass_us, 20 + step) for step in range(60)) < (26 + 2 * 27) * pass_us / 1000 + 10


def second_on_ms(pass_us: int, after_ms: float) -> float:
    """How long servo 12 takes to be fed that is wanted so long after servo 11."""
    link = Link(pass_ns=1000 * pass_us)
    link.want(NONE)
    link.run(200)
    link.want(frozenset({11}))
    link.run(after_ms)  # the answer comes in this time
    link.want(frozenset({11, 12}))
    return link.run_until(lambda: link.fed() == {11, 12})


def test_an_off_waits_for_no_on_and_takes_none_along_before_its_time() -> None:
    link = Link()
    link.want(frozenset({11}))
    link.run_until(lambda: link.ours.status.supplied == {11})
    at_ns = link.now_ns
    link.want(frozenset({12}))
    link.run(700)
    assert link.masks(at_ns)[0] == (0, 0)
    assert next(ms for ms, mask in link.masks(at_ns) if mask == 0b10) >= 5


@pytest.mark.parametrize("pass_us", [1000, 2000])
def test_an_off_right_behind_an_answer_is_at_once_and_confirmed_a_round_of_the_counter_later(pass_us: int) -> None:
    link = fed(pass_ns=1000 * pass_us)
    link.want(ALL_SERVOS - {11})
    answered = len(link.answers)
    link.run_until(lambda: any(frame.id == 0x6B for _, frame in link.answers[answered:]))
    link.cut()
    link.when_off(ALL_SERVOS, token=1)
    link.run(0.3)
    assert link.fed() == NONE
    link.run(600)
    assert link.ours.confirmed


@pytest.mark.parametrize("pass_us", [1000, 1500, 2000])
@pytest.mark.parametrize("behind_ms", [1, 50, 100, 150, 300, 600])
def test_a_stop_while_others_are_switched_on_is_confirmed_in_time(pass_us: int, behind_ms: int) -> None:
    """The board answers a mask once all is on: all eighteen at once would take a second."""
    link = Link(pass_ns=1000 * pass_us, confirm_ms=450)
    link.want(NONE)
    link.run(700)
    link.want(ALL_SERVOS)
    link.run(behind_ms)
    link.want(ALL_SERVOS - {61, 62, 63})
    link.when_off(frozenset({61, 62, 63}), token=1)
    link.run(450)
    (confirmed,) = link.confirmations()
    assert confirmed.confirmed
    assert link.events(Kind.POWER_UNCONFIRMED) == []
    link.run(1100)
    assert link.fed() == ALL_SERVOS - {61, 62, 63}


# ---- answers that are late, lost or others'


def test_old_answers_of_a_link_that_paused_confirm_nothing() -> None:
    """While it paused the board was off and on again: its answers of then show all off."""
    link = fed()
    link.pause()
    link.want(NONE)
    link.run(60)
    assert any(frame == CanFrame(0x6B, bytes(3)) for frame in link.held or [])
    link.want(ALL_SERVOS)
    link.other_node(ALL)  # whoever did it: the board feeds all
    link.run(20)
    link.cable = False  # and our next mask never arrives
    link.cut()
    link.when_off(ALL_SERVOS, token=1)
    link.run(5)
    link.cable = True
    link.resume()
    link.run(12)
    assert not link.ours.confirmed
    assert not any(confirmed.confirmed for confirmed in link.confirmations())


# ---- silence


def test_an_interface_that_is_gone_is_reported_at_once_and_once() -> None:
    link = fed()
    link.ours.closed("unplugged", link.now_ns)
    link.ours.closed("unplugged", link.now_ns)
    assert [item.detail for item in link.ours.news() if isinstance(item, News)] == ["unplugged"]
    assert not link.ours.alive


def test_lost_answers_to_questions_are_no_silence_and_all_is_measured() -> None:
    link = Link(faults=0.2, seed=1)
    link.alters = False  # an error frame that was altered is an unknown error
    link.run(20_000)
    assert link.events(Kind.POWER_UNCONFIRMED) == []
    assert len(link.ours.status.currents_ma) == 18
    assert len(link.ours.status.rails) == 6


def test_questions_do_not_flood_the_bus() -> None:
    link = fed()
    at_ns = link.now_ns
    link.run(1000)
    asked = [frame for when_ns, frame in link.sent if when_ns >= at_ns]
    assert len(asked) == pytest.approx(100, abs=2)
    assert sum(frame in ASK_CURRENTS for frame in asked) >= 80
