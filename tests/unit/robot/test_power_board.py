"""What is sent to the power board, and what counts as confirmed: against the simulated board, in virtual time."""

import pytest

from gateway.model.power_board import (
    ASK_CURRENTS,
)
from gateway.robot.power.board import News
from schemas.telemetry import Kind
from tests.support.power_link import ALL_SERVOS, NONE, Link, fed

# ---- off


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
