"""What is sent to the power board, and what counts as confirmed: against the simulated board, in virtual time."""

import pytest

from gateway.allowance import NS_PER_MS
from gateway.model.power_board import (
    ALL,
    ASK_CURRENTS,
    CanFrame,
    set_supply,
)
from gateway.robot.power.board import News
from gateway.robot.power.offs import Confirmed
from schemas.telemetry import Kind
from tests.support.power_link import ALL_SERVOS, CONFIRM_MS, FLIGHT_NS, NONE, Link, fed

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


def test_it_is_repeated_every_20_ms_for_2_s_and_reported_once() -> None:
    link = fed()
    link.cable = False
    at_ns = link.now_ns
    link.cut()
    link.when_off(ALL_SERVOS, token=1)
    link.run(3000)
    masks = link.masks(at_ns)
    assert [ms for ms, _ in masks] == [20 * n for n in range(100)]
    assert {mask for _, mask in masks} == {0}
    unconfirmed = [(at_ns, item.detail) for at_ns, item in link.events(Kind.POWER_UNCONFIRMED)]
    assert [detail for _, detail in unconfirmed] == [
        "the power board does not answer",
        "the power board has not confirmed that these are off",
    ]
    assert [round((each_ns - at_ns) / NS_PER_MS) for each_ns, _ in unconfirmed] == [pytest.approx(100, abs=12), 150]
    assert list(link.confirmations()) == [Confirmed(1, False, None)]
    # The board comes back: its mask leaves at once, for the next 2 s.
    link.cable = True
    link.run(100)
    assert link.ours.confirmed
    assert link.fed() == NONE


def test_who_asks_again_for_what_was_given_up_has_it_sent_again() -> None:
    link = fed()
    link.altered = lambda frame: CanFrame(0x100) if frame.id == 0x6B else frame
    link.want(ALL_SERVOS - {11})
    link.run(2500)
    at_ns = link.now_ns
    link.when_off(frozenset({11}), token=1)
    link.altered = lambda frame: frame
    link.run(100)
    assert link.masks(at_ns)[0] == (0, ALL & ~1)
    assert [each.confirmed for each in link.confirmations()] == [True]


def test_a_stop_of_some_keeps_the_others() -> None:
    link = fed()
    some = frozenset({11, 42})
    at_ns = link.now_ns
    link.want(ALL_SERVOS - some)
    link.when_off(some, token=1)
    link.run(0.3)
    assert link.fed() == ALL_SERVOS - some
    link.run(100)
    assert [confirmed.confirmed for confirmed in link.confirmations()] == [True]
    assert {mask for _, mask in link.masks(at_ns)} == {ALL & ~1 & ~(1 << 10)}


def test_a_confirmation_of_what_was_off_is_a_new_one() -> None:
    link = fed()
    link.want(NONE)
    link.run(500)
    at_ns = link.now_ns
    link.when_off(ALL_SERVOS, token=2)
    link.run(100)
    assert len(link.masks(at_ns)) >= 1
    [confirmed] = link.confirmations()
    assert confirmed.ms is not None
    assert confirmed.ms > 25 * 1.5


def test_servos_that_are_wanted_are_not_confirmed_off() -> None:
    link = fed()
    at_ns = link.now_ns
    link.when_off(ALL_SERVOS, token=3)
    link.run(CONFIRM_MS)
    assert list(link.confirmations()) == [Confirmed(3, False, None)]
    assert link.masks(at_ns) == []


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


def test_an_output_that_stays_on_is_reported_by_its_servo() -> None:
    link = fed()
    stuck = 1 << 3
    link.altered = lambda frame: set_supply(stuck)._replace(id=0x6B) if frame.id == 0x6B else frame
    link.cut()
    link.when_off(ALL_SERVOS, token=1)
    link.run(1000)
    [(_, news)] = link.events(Kind.POWER_UNCONFIRMED)
    assert news.servos == {21}
    assert not link.ours.confirmed
    assert list(link.confirmations()) == [Confirmed(1, False, None)]


def test_what_was_decided_before_an_emergency_stop_gives_nothing_back() -> None:
    link = fed()
    link.cut()
    link.want(ALL_SERVOS)
    link.run(1500)
    assert link.fed() == NONE
    link.want_anew(ALL_SERVOS)
    link.run(1500)
    assert link.fed() == ALL_SERVOS
    assert [item.kind for _, item in link.news if isinstance(item, News)] == []


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


def test_nothing_is_switched_on_while_the_board_does_not_answer() -> None:
    link = Link()
    link.cable = False
    link.want(ALL_SERVOS)
    link.run(500)
    assert link.masks() == []
    link.cable = True
    link.run(1500)
    assert link.fed() == ALL_SERVOS


def test_nothing_is_sent_but_questions_until_something_is_wanted_or_cut() -> None:
    link = fed()
    link.ours = Link().ours
    at_ns = link.now_ns
    link.run(500)
    assert link.masks(at_ns) == []
    link.want(ALL_SERVOS)
    link.run(1500)
    assert link.ours.status.supplied == ALL_SERVOS


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


def test_what_waits_to_be_fed_waits_for_no_off_that_is_late() -> None:
    link = fed()
    link.altered = lambda frame: CanFrame(0x6B, frame.data[:2] + b"\1") if frame.id == 0x6B else frame
    link.want(NONE)
    link.run(100)
    link.want(frozenset({63}))
    link.run(CONFIRM_MS - 110)
    assert link.fed() == NONE, "11 is not confirmed yet"
    link.run(400)
    assert link.fed() == {63}


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


def test_a_board_that_falls_silent_is_reported_within_200_ms_and_feeds_nothing_unasked_later() -> None:
    link = fed()
    link.board.restart()
    took_ms = link.run_until(lambda: not link.ours.alive)
    assert took_ms < 150
    link.run(1)
    [(_, news)] = link.events(Kind.POWER_UNCONFIRMED)
    assert news.servos == link.ours.status.lost == ALL_SERVOS
    link.run(300)
    link.want(ALL_SERVOS)  # as each step says, until its owner has seen the news
    link.board.press_button(link.now_ns)
    link.run(2000)
    assert link.ours.alive
    assert link.fed() == NONE
    link.want_anew(ALL_SERVOS)
    link.run(1500)
    assert link.fed() == ALL_SERVOS
    assert link.ours.status.lost == NONE


def test_a_silence_of_the_link_alone_takes_no_supply_of_a_leg_that_lands() -> None:
    link = fed()
    link.cable = False
    link.run(300)
    link.want(ALL_SERVOS)
    link.cable = True
    link.run(2000)
    assert link.ours.alive
    assert link.fed() == ALL_SERVOS
    link.want(ALL_SERVOS - {11, 12, 13})
    link.run(2000)
    assert not link.fed() & {11, 12, 13}


def test_a_process_that_was_suspended_reports_no_silence() -> None:
    link = fed()
    link.now_ns += 5000 * NS_PER_MS
    link.run(500)
    assert link.ours.alive
    assert link.news == []


def test_a_sender_that_hangs_is_a_silence() -> None:
    link = fed()
    link.hangs = True
    link.cut()
    link.when_off(ALL_SERVOS, token=1)
    assert link.run_until(lambda: not link.ours.alive) < 200
    link.run(200)
    assert len(link.events(Kind.POWER_UNCONFIRMED)) == 2
    assert list(link.confirmations()) == [Confirmed(1, False, None)]


def test_an_interface_that_is_gone_is_reported_at_once_and_once() -> None:
    link = fed()
    link.ours.closed("unplugged", link.now_ns)
    link.ours.closed("unplugged", link.now_ns)
    assert [item.detail for item in link.ours.news() if isinstance(item, News)] == ["unplugged"]
    assert not link.ours.alive


def test_on_a_new_interface_what_is_not_confirmed_leaves_at_once() -> None:
    link = fed()
    link.cable = False
    link.cut()
    link.run(2500)
    at_ns = link.now_ns
    link.ours.opened(at_ns)
    link.run(1)
    assert link.masks(at_ns) == [(0, 0)]


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


def test_what_is_not_confirmed_as_a_gateway_starts_is_reported_after_a_second() -> None:
    link = Link()
    link.cable = False
    link.ours.opened(0)
    link.want(NONE)
    link.run(990)
    assert link.events(Kind.POWER_UNCONFIRMED) == []
    link.run(20)
    assert len(link.events(Kind.POWER_UNCONFIRMED)) == 1
    again = Link()
    again.ours.opened(0)
    again.want(NONE)
    again.run(1500)
    again.ours.opened(again.now_ns)
    again.cable = False
    again.cut()
    again.run(160)
    assert again.events(Kind.POWER_UNCONFIRMED), "one that starts later does not"
