"""Which masks the power board is sent, and when, where masks are lost or cross its answers: in virtual time."""

from gateway.allowance import NS_PER_MS
from gateway.model.power_board import ASK_CURRENTS, SET_SUPPLY, SUPPLIED, CanFrame, set_supply
from tests.support.power_link import ALL_SERVOS, FLIGHT_NS, NONE, Link, fed


def at_rest() -> Link:
    """A link whose board has confirmed that all is off."""
    link = Link()
    link.want(NONE)
    link.run(300)
    assert link.ours.confirmed
    return link


def test_an_on_waits_for_the_answer_to_an_off_that_crossed_the_answer_before() -> None:
    """The counter is not at rest before: the on would be 230 passes late."""
    link = at_rest()
    link.want(frozenset({11}))
    answered_ms = link.run_until(lambda: link.ours.status.supplied == {11})
    link = at_rest()
    link.want(frozenset({11}))
    link.run(answered_ms - 1)
    at_ns = link.now_ns
    link.want(NONE)
    link.run(0.5)
    link.want(frozenset({12}))
    link.run(500)
    assert link.masks(at_ns)[0] == (0, 0)
    assert min(ms for ms, mask in link.masks(at_ns) if mask) > 30
    assert link.fed() == {12}


def test_a_repeat_waits_for_5_ms_behind_an_answer() -> None:
    """In whose pass the board would take it 230 passes late."""
    link = at_rest()
    link.altered = lambda frame: frame if frame.id == SUPPLIED else CanFrame(0x100)
    at_ns = link.now_ns
    link.cut()
    link.run(500)
    repeats_ns = [at_ns + ms * NS_PER_MS for ms, _ in link.masks(at_ns)[1:]]
    answers_ns = [sent_ns + FLIGHT_NS for sent_ns, frame in link.answers if frame.id == SUPPLIED]
    behind_ns = [each - answered for each in repeats_ns for answered in answers_ns if each >= answered]
    assert len(repeats_ns) > 10
    assert min(behind_ns) >= 5 * NS_PER_MS


def test_a_frame_that_is_not_the_boards_is_no_sign_of_it() -> None:
    link = Link()
    for frame in (CanFrame(0x100), CanFrame(SUPPLIED, b"\0"), CanFrame(SET_SUPPLY, bytes(3))):
        link.ours.receive(frame, 1)
    assert not link.ours.alive
    assert link.ours.status.answered_ns is None


def test_not_even_the_first_off_is_confirmed_by_an_answer_that_was_on_its_way() -> None:
    ours = Link().ours
    ours.receive(CanFrame(ASK_CURRENTS[0].id + 1, bytes(6)), 0)
    ours.want(NONE, 0, 0)
    assert ours.next_frames(0)[0] == set_supply(0)
    ours.receive(CanFrame(SUPPLIED, bytes(3)), 1)
    assert not ours.confirmed


def test_what_servos_drew_before_a_silence_is_not_known_any_more() -> None:
    link = fed()
    assert len(link.ours.status.currents_ma) == len(ALL_SERVOS)
    link.cable = False
    link.run(300)
    assert link.ours.status.currents_ma == {}


def test_what_is_wanted_again_counts_as_fed_once_the_board_says_so_anew() -> None:
    link = fed()
    assert link.ours.status.fed == ALL_SERVOS
    link.want(ALL_SERVOS - {11})
    assert link.ours.status.fed == ALL_SERVOS - {11}
    link.want(ALL_SERVOS)
    assert link.ours.status.fed == ALL_SERVOS - {11}
    link.run_until(lambda: 11 in link.ours.status.fed)
    assert link.fed() == ALL_SERVOS


def test_an_old_answer_that_shows_it_on_does_not_count_as_fed() -> None:
    link = fed()
    link.want(ALL_SERVOS - {11})
    link.run(1)
    link.want(ALL_SERVOS)
    link.ours.receive(CanFrame(0x6B, bytes.fromhex("03ffff")), link.now_ns)
    assert 11 not in link.ours.status.fed


def test_what_a_servo_drew_before_it_was_fed_is_forgotten_once_it_is() -> None:
    link = fed()
    link.want_anew(ALL_SERVOS - {11})
    link.run(1500)
    assert link.ours.status.currents_ma[11] == 0
    link.board.draws_ma[0] = 200.0
    link.want(ALL_SERVOS)
    link.run_until(lambda: 11 in link.ours.status.fed)
    assert link.ours.status.currents_ma.get(11) is None
    link.run(200)
    assert link.ours.status.currents_ma[11] == 200
