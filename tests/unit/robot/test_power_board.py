"""The power board: what is asked, sent, fed and confirmed; against the simulated board, in virtual time."""

import random
from collections.abc import Callable
from functools import partial
from types import SimpleNamespace
from typing import Final, cast

import pytest

from gateway.model.power_board import (
    ALL,
    ASK_CURRENTS,
    ASK_ERROR,
    ASK_RAILS,
    CLEAR_ERROR,
    GOING_OFF,
    OFF_PRESSED,
    SET_SUPPLY,
    SUPPLIED,
    SUPPLY_LOW,
    CanFrame,
    set_supply,
)
from gateway.rate_limit import NS_PER_MS, NS_PER_S
from gateway.robot.core.rules import Rules
from gateway.robot.core.supervisor import Supervisor
from gateway.robot.power.board import Confirmed, News, PowerBoard, Status, Then
from gateway.robot.power.line import PowerLine
from gateway.robot.power.questions import BoardErrors, BoardQuestions
from gateway.robot.runtime.supply import MOST_WAITING, Judged, RobotSupply, findings
from gateway.robot.spi import Wire
from gateway.simulation.board import SimulatedBoard
from schemas.robot import SERVO_IDS
from schemas.words import Kind
from tests.support.power import ALL_SERVOS, CONFIRM_MS, NONE, Link, fed

# ---- on


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
    link.when_off(frozenset({61, 62, 63}))
    link.run(450)
    (confirmed,) = link.confirmations()
    assert confirmed.ms is not None
    assert link.events(Kind.POWER_UNCONFIRMED) == []
    link.run(1100)
    assert link.fed() == ALL_SERVOS - {61, 62, 63}


def test_outputs_go_on_six_at_a_time_in_their_order() -> None:
    link = at_rest()
    at_ns = link.now_ns
    link.want(ALL_SERVOS)
    link.run(700)
    masks = dict.fromkeys(frame for when_ns, frame in link.sent if when_ns >= at_ns and frame.id == SET_SUPPLY)
    assert list(masks) == [set_supply((1 << on) - 1) for on in (6, 12, 18)]


# ---- silence


def test_questions_do_not_flood_the_bus() -> None:
    link = fed()
    at_ns = link.now_ns
    link.run(1000)
    asked = [frame for when_ns, frame in link.sent if when_ns >= at_ns]
    assert len(asked) == pytest.approx(100, abs=2)
    assert sum(frame in ASK_CURRENTS for frame in asked) >= 80


# ---- Which masks the power board is sent, and when, where masks are lost or cross its answers: in virtual time


def at_rest() -> Link:
    """Return a link whose board has confirmed that all is off."""
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


def test_not_even_the_first_off_is_confirmed_by_an_answer_that_was_on_its_way() -> None:
    ours = Link().ours
    ours.receive(CanFrame(ASK_CURRENTS[0].id + 1, bytes(6)), 0)
    ours.want(NONE, 0, 0)
    assert ours.next_frames(0)[0] == set_supply(0)
    ours.receive(CanFrame(SUPPLIED, bytes(3)), 1)
    assert not ours.confirmed


# ---- another node, and a second board


@pytest.fixture
def board() -> PowerBoard:
    return PowerBoard(SERVO_IDS, confirm_ns=CONFIRM_MS * NS_PER_MS)


def answer_to(question: CanFrame) -> CanFrame:
    return CanFrame(question.id + 1, bytes(6 if question.id in (0x7C, 0x80, 0x86) else 4))


def test_an_answer_to_another_nodes_question_confirms_nothing(board: PowerBoard) -> None:
    """That question was asked before our mask, which has not reached the board."""
    board.receive(CanFrame(0x97), 0)
    board.cut(0)
    then: Then = lambda _: None  # noqa: E731
    board.when_off(ALL_SERVOS, -10, then, 0)
    (asked,) = (frame for frame in board.next_frames(0) if frame in ASK_RAILS)
    board.receive(asked, 1)
    board.receive(answer_to(asked), 2)
    board.receive(CanFrame(0x6B, bytes(3)), 3)
    assert not board.confirmed
    board.receive(answer_to(asked), 4)
    board.receive(CanFrame(0x6B, bytes(3)), 5)
    assert board.confirmed, "the second answer is ours"
    assert board.news == [Confirmed(then, 15 / NS_PER_MS)]


def test_no_error_is_deleted_before_the_board_has_a_mask_without_what_it_blocks(board: PowerBoard) -> None:
    error = CanFrame(0x65, bytes.fromhex("02000001"))
    board.want(NONE, 1, 0)
    board.receive(error, 0)
    board.clear_errors(0)
    (asked,) = (frame for frame in board.next_frames(0) if frame in ASK_RAILS)
    board.receive(error, 1)
    assert CLEAR_ERROR not in board.next_frames(1)
    board.receive(answer_to(asked), 2)
    board.receive(error, 3)
    assert CLEAR_ERROR in board.next_frames(3)


def test_what_had_no_room_is_sent_again_at_once_and_nothing_else(board: PowerBoard) -> None:
    assert (Status().alive, Status().confirmed) == (False, False)
    board.receive(CanFrame(0x97), 0)
    board.cut(0)
    for now_ns in range(10):
        mask, question, *_ = frames = board.next_frames(now_ns)
        assert (mask, question in ASK_RAILS) == (set_supply(0), True)
        board.not_sent(frames[1:], now_ns)
        assert set_supply(0) not in board.next_frames(now_ns)
        board.not_sent([mask], now_ns)
    (asked,) = (frame for frame in board.next_frames(10) if frame in ASK_RAILS)
    board.receive(answer_to(asked), 11)
    board.receive(CanFrame(0x6B, bytes(3)), 12)
    assert board.confirmed


@pytest.mark.parametrize("seed", range(20))
def test_beside_a_node_that_asks_and_switches_nothing_is_confirmed_before_a_mask_has_arrived(seed: int) -> None:
    """Of what we send next to nothing reaches the board, for up to a second; we receive all."""
    chance = random.Random(seed)  # noqa: S311
    link, deaf_ms, reached = fed(), chance.randrange(1000), False
    ours, board, begun_ns = link.ours, link.board, link.now_ns
    ours.cut(begun_ns)
    for ms in range(2500):
        now_ns = begun_ns + ms * NS_PER_MS
        frames = [frame for frame in ours.next_frames(now_ns) if ms >= deaf_ms]
        reached = reached or any(frame.id == SET_SUPPLY for frame in frames)
        theirs = [chance.choice(ASK_RAILS)] if chance.random() < 0.2 else []
        theirs += [set_supply(chance.choice([0, ALL]))] if chance.random() < 0.02 and ms < 1500 else []
        for frame in theirs:
            ours.receive(frame, now_ns)
        for answer in [each for frame in (*frames, *theirs) for each in board.take(frame, now_ns)]:
            ours.receive(answer, now_ns)
        for answer in board.advance(now_ns):
            ours.receive(answer, now_ns)
        assert reached or not ours.confirmed
    assert ours.confirmed
    assert board.fed == 0


@pytest.mark.parametrize(("identifier", "words"), [(OFF_PRESSED, "pressed"), (GOING_OFF, "has asked")])
def test_what_is_reported_once_has_ended_after_a_second_without_its_frames(
    board: PowerBoard, identifier: int, words: str
) -> None:
    reported = []
    for at_ms in (0, 999, 1998, 2998):
        board.receive(CanFrame(identifier), at_ms * NS_PER_MS)
        reported += [(at_ms, words in news.detail) for news in board.news if isinstance(news, News)]
        board.news.clear()
    assert reported == [(0, True), (2998, True)]


def servos(words: str) -> frozenset[int]:
    """Return the servos in `all`, `none`, `11,12` or `all-11,12`."""
    whole, _, without = words.partition("-")
    found = ALL_SERVOS if whole == "all" else frozenset(map(int, whole.split(","))) if whole != "none" else frozenset()
    return found - (servos(without) if without else frozenset())


def mask(words: str) -> int:
    return sum(1 << SERVO_IDS.index(servo) for servo in servos(words))


def _alter(link: Link, shown: int | None) -> None:
    """Show these outputs as on in the board's answers; None: lose the answers."""

    def altered(frame: CanFrame) -> CanFrame:
        if frame.id != SUPPLIED:
            return frame
        lost, known = CanFrame(0x100), int.from_bytes(frame.data, "big")
        return lost if shown is None else set_supply(known | shown)._replace(id=SUPPLIED)

    link.altered = altered


def _second(link: Link) -> None:
    """Add a second board, which answers as the first one does."""
    link.second = SimulatedBoard(link.now_ns)


def _repeat(link: Link, words: str) -> None:
    """Repeat `4000 0.25 hears 69`: so many times, with this many milliseconds after each."""
    times, pause_ms, word, rest = words.split(" ", 3)
    for _ in range(int(times)):
        DONE[word](link, rest)
        link.run(float(pause_ms))


DONE: Final[dict[str, Callable[[Link, str], object]]] = {
    "run": lambda link, ms: link.run(float(ms)),
    "until-fed": lambda link, servo: link.run_until(lambda: int(servo) in link.ours.status.fed),
    "repeat": _repeat,
    # the gateway
    "want": lambda link, who: link.want(servos(who)),
    "anew": lambda link, who: DONE["want"](link, "none") or DONE["want"](link, who),
    "cut": lambda link, _: link.cut(),
    "ask": lambda link, who: link.when_off(servos(who)),
    "reset": lambda link, _: link.clear_errors(),
    "opened": lambda link, _: link.ours.opened(link.now_ns),
    "gone": lambda link, why: link.ours.fall_silent(why, link.now_ns),
    "hangs": lambda link, _: setattr(link, "hangs", True),
    # the link
    "cable": lambda link, state: setattr(link, "cable", state == "on"),
    "deaf": lambda link, state: setattr(link, "deaf", state == "on"),
    "hears": lambda link, frame: link.ours.receive(CanFrame(int(frame[:2], 16), bytes.fromhex(frame[2:])), link.now_ns),
    "shows": lambda link, who: _alter(link, None if who == "nothing" else mask(who)),
    # another node; the board may receive it, and we do not
    "other": lambda link, who: link.hear_from_another(set_supply(mask(who))),
    "unheard": lambda link, who: link.board.take(set_supply(mask(who)), link.now_ns),
    # the board
    "blocks": lambda link, who: link.board.fail(2, mask(who)),
    "low": lambda link, _: link.board.fail(SUPPLY_LOW),
    "draws": lambda link, ma: link.board.draws_ma.__setitem__(0, float(ma)),
    "second": lambda link, _: _second(link),
    "first-goes": lambda link, _: vars(link).update(board=link.second, second=None),
    "by-hand": lambda link, _: link.board.clear_by_hand(),
    "press": lambda link, _: link.board.press_button(link.now_ns),
    "restart": lambda link, _: link.board.restart(),
}


def _counted(kind: Kind) -> Callable[[Link, str, int], tuple[object, object]]:
    return lambda link, count, _: (len(link.events(kind)), int(count))


SO: Final[dict[str, Callable[[Link, str, int], tuple[object, object]]]] = {
    # what is, and what is to be; masks are those since the line began, at this time
    "fed": lambda link, who, _: (link.fed(), servos(who)),
    "off": lambda link, who, _: (link.fed() & servos(who), frozenset()),
    "counts-fed": lambda link, who, _: (link.ours.status.fed, servos(who)),
    "currents": lambda link, count, _: (len(link.ours.status.currents_ma), int(count)),
    "draw-of-11": lambda link, ma, _: (str(link.ours.status.currents_ma.get(11)), ma),
    "few-masks": lambda link, most, at_ns: (len(link.masks(at_ns)) <= int(most), True),
    "few-faults": lambda link, most, _: (len(link.events(Kind.POWER_FAULT)) <= int(most), True),
    "lost": lambda link, who, _: (link.ours.status.lost, servos(who)),
    "refused": lambda link, who, _: (frozenset(link.ours.status.refused), servos(who)),
    "confirmed": lambda link, word, _: (link.ours.confirmed, word == "yes"),
    "alive": lambda link, word, _: (link.ours.alive, word == "yes"),
    "answers": lambda link, words, _: (
        [each.ms is not None for each in link.confirmations()],
        [w == "yes" for w in words.split()],
    ),
    "masks": lambda link, words, at_ns: ([each for _, each in link.masks(at_ns)], list(map(mask, words.split()))),
    "first": lambda link, who, at_ns: (link.masks(at_ns)[0], (0, mask(who))),
    "repeats": lambda link, count, at_ns: (link.masks(at_ns), [(20 * n, 0) for n in range(int(count))]),
    "news": lambda link, count, _: (len(link.told), int(count)),
    "faults": _counted(Kind.POWER_FAULT),
    "unconfirmed": _counted(Kind.POWER_UNCONFIRMED),
    "presses": _counted(Kind.OFF_BUTTON),
    "fault-of": lambda link, who, _: (link.events(Kind.POWER_FAULT)[0][1].servos, servos(who)),
    "doubt-of": lambda link, who, _: (link.events(Kind.POWER_UNCONFIRMED)[0][1].servos, servos(who)),
    "told": lambda link, word, _: (word in str(link.told), True),
}


def play(link: Link, scene: str) -> None:
    """Play lines of `what is done; … → the result; …`."""
    for line in scene.strip().splitlines():
        done, _, facts = line.partition("  #")[0].partition("→")
        at_ns = link.now_ns
        for each in done.split(";"):
            word, _, rest = each.strip().partition(" ")
            DONE[word](link, rest)
        for fact in facts.split(";"):
            word, _, rest = fact.strip().partition(" ")
            found, expected = SO[word](link, rest, at_ns)
            assert found == expected, f"{line.strip()}: {fact}"


WITH_ALL_FED: Final = {
    # ---- off
    "a Stop of some keeps the others": """
        want all-11,42; ask 11,42; run 0.3 → fed all-11,42
        run 100 → answers yes; fed all-11,42""",
    "who asks again for what was given up has it sent again": """
        shows nothing; want all-11; run 3500 → answers
        ask 11; shows none; run 100 → first all-11; answers yes""",
    "a confirmation of what was off is a new one, at the board's pace": """
        want none; run 500 → fed none
        ask all; run 37 → answers
        run 63 → answers yes""",
    "an off that is taken back before it was sent is none": "anew all; run 1500 → fed all; confirmed yes; news 0",
    "servos that are wanted are not confirmed off": "ask all; run 150 → answers no; masks",
    "an output that stays on is reported by its servo": """
        shows 21; cut; ask all; run 1000 → unconfirmed 1; doubt-of 21; confirmed no; answers no""",
    "what was decided before an emergency stop gives nothing back": """
        cut; want all; run 1500 → fed none
        anew all; run 1500 → fed all; news 0""",
    "what waits to be fed waits for no off that is late": """
        shows 11; want none; run 30 → fed none
        want 63; run 110 → fed none
        run 400 → fed 63""",
    # ---- silence
    "a board that falls silent is reported within 150 ms, and feeds nothing unasked later": """
        restart; run 151 → alive no; unconfirmed 1; doubt-of all; lost all
        run 300; want all; press; run 2000 → alive yes; fed none
        anew all; run 1500 → fed all; lost none""",
    "a silence of the link alone takes no supply of a leg that lands": """
        cable off; run 300; want all; cable on; run 2000 → alive yes; fed all
        want all-11,12,13; run 2000 → off 11,12,13""",
    "a sender that hangs is a silence": """
        hangs; cut; ask all; run 200 → alive no
        run 200 → unconfirmed 2; answers no""",
    "an interface that is gone is reported at once and once": """
        gone unplugged; gone unplugged → alive no
        run 1 → unconfirmed 1; told unplugged""",
    "what servos drew before a silence is not known any more": "run 0 → currents 18\n cable off; run 300 → currents 0",
    "an old answer that shows it on does not count as fed": """
        want all-11; run 1; want all; hears 6b03ffff → counts-fed all-11""",
    "what a servo drew before it was fed is forgotten once it is": """
        anew all-11; run 1500 → draw-of-11 0
        draws 200; want all; until-fed 11 → draw-of-11 None
        run 200 → draw-of-11 200""",
    # ---- others that switch
    "a node that floods masks is answered at a pace and reported once a second": """
        repeat 8000 0.125 other none → few-masks 250; few-faults 2""",
    "what two boards answer confirms nothing": "second; cut; ask all; run 500 → answers no",
    "two boards on one bus are a fault and confirm nothing until a reset": """
        second; run 1000 → faults 1; fault-of all; told unplug one of them, and reset; refused all
        first-goes; cut; ask all; run 1000 → confirmed no; answers no  # it feeds what it fed
        want none; reset; run 1000 → confirmed yes; refused none""",
    "what another node switches off stays off until it is wanted anew": """
        other all-11,12,13; run 6 → masks all-11,12,13
        want all; run 1000 → lost 11,12,13; fed all-11,12,13; faults 1; fault-of 11,12,13; confirmed yes
        anew all; run 1000 → fed all""",
    "another node's mask that we did not receive goes off with the board's next answer": """
        want none; run 500 → fed none
        unheard all; run 1500 → fed none; confirmed yes""",
    "an output that the board takes by itself is lost": "unheard all-11; run 300 → lost 11; fault-of 11",
    "also behind a want that changes nothing": "want all; unheard all-63; run 300 → lost 63",
    "a mask of others that is ours changes nothing": """
        want all; other all; run 500 → fed all; confirmed yes; unconfirmed 0""",
    # ---- the board's own faults, and its button
    "a servo that is blocked leaves the mask, and stays off when the error is deleted by hand": """
        blocks 22; run 20 → masks all-22; lost 22; refused 22; told overcurrent
        by-hand; anew all; run 1000 → fed all-22; lost 22; refused 22
        reset; run 1000 → fed all-22; refused none
        anew all; run 1000 → fed all""",
    "an error that cannot be read takes all": "hears 651001; run 20 → fed none; fault-of all; told cannot be read",
    "a low supply is reported and takes nothing": "low; run 1000 → faults 1; told too low; fed all; refused none",
    **{
        f"{frame}, 4000 times a second, is one announcement until it ended": f"""
        repeat 4000 0.25 hears {frame} → news 1
        run 1000; hears {frame}; run 100 → news 2"""
        for frame in ("69", "67", "6508", "650420")
    },
    "the off button is an emergency stop again behind a reset": """
        press; run 10 → presses 1
        run 90; reset; press; run 100; reset → presses 2""",
}


@pytest.mark.parametrize("scene", WITH_ALL_FED)
def test_a_scene_that_begins_with_all_servos_fed(scene: str) -> None:
    play(fed(), WITH_ALL_FED[scene])


WITH_NOTHING_FED: Final = {
    "nothing is switched on while the board does not answer": """
        cable off; want all; run 500 → masks
        cable on; run 1500 → fed all""",
    "a gateway has a second to start": """
        cable off; opened; want none; run 990 → unconfirmed 0
        run 20 → unconfirmed 1""",
    "whenever that is": """
        cable off; run 3000; opened; want none; run 990 → unconfirmed 0
        run 20 → unconfirmed 1""",
    "but not where only its interface starts later": """
        opened; want none; run 1500 → unconfirmed 0
        opened; cable off; cut; run 160 → unconfirmed 2""",
    "what another node switches off while our on waits stays off": """
        want none; run 100; cut; want none; run 1 → fed none
        want all; other 11,12,13; run 1500 → fed 11,12,13; lost all-11,12,13""",
    "a mask that was lost once is made up for": """
        want none; run 300; deaf on; want 63; run 20; deaf off; run 200 → fed 63""",
    "a cut that nobody waits for is repeated for three seconds, and each is reported": """
        want none; run 300; deaf on → confirmed yes
        cut; run 5000 → repeats 150; unconfirmed 1
        cut; run 500 → unconfirmed 2""",
    "nor does what two boards answer from the beginning": "second; want none; run 400 → confirmed no",
    "an interface that opens again has the mask sent again": """
        want none; run 300; cable off; cut; run 4000 → confirmed no
        opened; run 1 → first none""",
    "each off that is not confirmed is reported": """
        want 11; run 300; deaf on; want none; run 300 → unconfirmed 1
        deaf off; run 300 → confirmed yes
        want 11; run 300; deaf on; want none; run 300 → unconfirmed 2
        deaf off; run 300 → confirmed yes""",
    "what another node switches on is taken again and again until the board has confirmed it": """
        want none; run 300 → confirmed yes
        other all; deaf on; run 500; deaf off → confirmed no
        run 100 → confirmed yes; fed none""",
}


@pytest.mark.parametrize("scene", WITH_NOTHING_FED)
def test_a_scene_that_begins_with_nothing_fed(scene: str) -> None:
    play(Link(), WITH_NOTHING_FED[scene])


def test_all_is_asked_in_turn_while_the_board_answers() -> None:
    questions = BoardQuestions()
    asked: list[CanFrame] = []
    for turn in range(14 * 6):
        [question] = questions.next(0, turn * 10 * NS_PER_MS)
        questions.answered(turn * 10 * NS_PER_MS)
        questions.answered_about_rails(question, 0)
        asked.append(question)
    assert [asked.count(question) for question in ASK_RAILS] == [1] * 6
    assert asked.count(ASK_ERROR) == 6
    assert {asked.count(question) for question in ASK_CURRENTS} == {12}


def test_a_question_with_an_unanswered_ask_proves_nothing_so_it_is_not_asked() -> None:
    questions = BoardQuestions()
    asked = [question for number in range(10) for question in questions.about_rails(number, number)]
    assert sorted(asked) == sorted(ASK_RAILS)
    questions.answered_about_rails(asked[2], 0)
    assert (questions.reached, questions.reached_ns) == (2, 2)
    assert questions.about_rails(10, 10) == [asked[2]]
    # An answer that nobody asked for, or a second one, proves nothing.
    questions.answered_about_rails(asked[3], 0)
    questions.answered_about_rails(asked[3], 0)
    assert questions.reached == 3


def test_an_ask_is_lost_once_a_later_one_was_answered_or_after_2_s() -> None:
    questions = BoardQuestions()
    [first] = questions.about_rails(1, 0)
    for _ in range(5):
        [last] = questions.about_rails(1, NS_PER_MS)
    assert questions.about_rails(2, 1999 * NS_PER_MS) == []
    assert questions.about_rails(2, 2000 * NS_PER_MS) == [first]
    questions = BoardQuestions()
    [first] = questions.about_rails(1, 0)
    for number in range(5):
        [last] = questions.about_rails(1, number + 1)
    questions.answered_about_rails(last, 0)
    assert questions.about_rails(2, 299 * NS_PER_MS) == [last]
    assert questions.about_rails(2, 300 * NS_PER_MS) == [first]


def asked_every_10_ms(count: int) -> BoardQuestions:
    """Return a board that answered at 1000 ms, and to none of the later questions, the first at 1000 ms."""
    questions = BoardQuestions()
    questions.answered(1000 * NS_PER_MS)
    for number in range(count):
        questions.next(0, (1000 + 10 * number) * NS_PER_MS)
    return questions


def test_the_board_is_silent_once_ten_questions_and_100_ms_went_by_without_an_answer() -> None:
    questions = asked_every_10_ms(10)
    assert not questions.silent(1100 * NS_PER_MS - 1)
    assert questions.silent(1100 * NS_PER_MS)
    questions.answered(1100 * NS_PER_MS)
    assert not questions.silent(1100 * NS_PER_MS)
    assert not asked_every_10_ms(9).silent(1100 * NS_PER_MS)


def test_a_question_that_nobody_fetched_for_20_ms_counts_as_unanswered() -> None:
    questions = BoardQuestions()
    questions.answered(0)
    silent = [questions.silent(at_ms * NS_PER_MS) for at_ms in range(10, 120, 10)]
    assert silent == [False] * 10 + [True]
    assert questions.due_ns == 100 * NS_PER_MS, "and it is due since"


def test_while_the_board_is_likely_silent_rails_are_kept_for_when_it_answers() -> None:
    questions = asked_every_10_ms(5)
    assert questions.about_rails(1, 0) != []
    questions = asked_every_10_ms(6)
    assert questions.about_rails(1, 0) == []
    questions.answered(0)
    assert questions.about_rails(1, 0) != []


@pytest.mark.parametrize(("at_ms", "reached"), [(1999, 0), (2000, 1)])
def test_an_answer_is_for_another_node_that_asked_within_2_s(at_ms: int, reached: int) -> None:
    questions = BoardQuestions()
    [question] = questions.about_rails(1, 0)
    questions.asked_by_another(question, NS_PER_S)
    questions.answered_about_rails(question, NS_PER_S + at_ms * NS_PER_MS)
    assert questions.reached == reached


@pytest.mark.parametrize(
    ("late_ns", "pairs", "two_boards"), [(10 * NS_PER_MS - 1, 3, True), (10 * NS_PER_MS, 3, False), (0, 2, False)]
)
def test_two_boards_answer_each_of_three_questions_twice_within_10_ms(
    late_ns: int, pairs: int, two_boards: bool
) -> None:
    questions = BoardQuestions()
    for _ in range(pairs):
        [question] = questions.about_rails(1, 0)
        for at_ns in (0, late_ns):
            questions.answered_about_rails(question, at_ns)
    assert questions.two_boards is two_boards
    for _ in range(2):
        questions.answered_about_rails(questions.about_rails(1, 0)[0], 0)
    assert (questions.doubles == 0) is not two_boards, "a question answered once ends the row, but not a fault"


# ---- The power board's errors: what they block, and how they are deleted


HOT: Final = dict.fromkeys((11, 12), "overtemperature")
DRAWN: Final = "overcurrent"


@pytest.fixture
def errors() -> BoardErrors:
    return BoardErrors()


def frames(errors: BoardErrors, at_ms: range, *, without: bool = True) -> list[tuple[int, CanFrame]]:
    """Return what leaves, with its time (ms)."""
    return [(ms, frame) for ms in at_ms for frame in errors.next_frames(ms * NS_PER_MS, without=without)]


def test_each_is_shown_and_then_deleted_until_the_board_has_none(errors: BoardErrors) -> None:
    errors.shown(2, {11: DRAWN}, 0)
    errors.shown(2, {63: DRAWN}, 0)
    errors.shown(4, HOT, 0)
    assert errors.blocked.keys() == {11, 12, 63}
    errors.deleted(0)
    errors.none_left()
    assert errors.blocked.keys() == {11, 12, 63}, "somebody at the board has deleted them"
    errors.delete(10 * NS_PER_MS)
    assert errors.due_ns == 10 * NS_PER_MS
    assert frames(errors, range(30)) == [(10, ASK_ERROR)]
    errors.shown(4, HOT, 30 * NS_PER_MS)
    assert frames(errors, range(30, 40)) == [(30, CLEAR_ERROR)]
    errors.deleted(40 * NS_PER_MS)
    assert frames(errors, range(40, 50)) == [(40, ASK_ERROR)]
    assert errors.blocked == {11: DRAWN, 63: DRAWN}
    errors.shown(2, {11: DRAWN}, 50 * NS_PER_MS)
    assert frames(errors, range(50, 60)) == [(50, CLEAR_ERROR)]
    errors.none_left()
    assert errors.blocked == {}
    assert errors.due_ns is None


def test_without_an_answer_it_asks_again_every_50_ms_for_two_seconds(errors: BoardErrors) -> None:
    errors.delete(0)
    errors.deleted(0)  # by another program
    assert frames(errors, range(1950)) == [(ms, ASK_ERROR) for ms in range(0, 1950, 50)]
    assert errors.due_ns is not None
    assert frames(errors, range(1950, 5000)) == [(1950, ASK_ERROR)]
    assert errors.due_ns is None


@pytest.mark.parametrize(
    ("then", "left"),
    [
        (lambda _: None, [(0, CLEAR_ERROR), (50, ASK_ERROR)]),
        (lambda errors: errors.deleted(NS_PER_MS), [(1, ASK_ERROR), (51, ASK_ERROR)]),
        (lambda errors: errors.delete(5 * NS_PER_MS), [(5, ASK_ERROR), (55, ASK_ERROR)]),
    ],
    ids=["its answer was lost", "another program has deleted it", "deleting begins anew"],
)
def test_what_was_shown_is_deleted_once(
    errors: BoardErrors, then: Callable[[BoardErrors], None], left: list[tuple[int, CanFrame]]
) -> None:
    errors.delete(0)
    errors.shown(2, {11: DRAWN}, 0)
    then(errors)
    assert frames(errors, range(60)) == left


def test_none_is_deleted_while_the_board_may_feed_what_it_blocks(errors: BoardErrors) -> None:
    errors.delete(0)
    errors.shown(2, {11: DRAWN}, 0)
    assert frames(errors, range(60), without=False) == [(50, ASK_ERROR)]
    errors.shown(2, {11: DRAWN}, 60 * NS_PER_MS)
    assert frames(errors, range(60, 70)) == [(60, CLEAR_ERROR)]


# ---- What currents say about Stops


CURRENTS: Final[dict[str, tuple[str, list[str]]]] = {
    # ms, the current of servo 11 in mA, and `!` while it runs; and at which of them it is reported
    "the second measurement 300 ms behind a Stop": ("0 151; 299 151; 300 151; 301 151; 302 151", ["301"]),
    "at rest it draws 150 mA at most": ("0 150; 400 150; 500 150", []),
    "a pause, and a single measurement": ("0 8; 400 900; 500 8; 600 900; 700 8", []),
    "again behind the next Stop": ("0 900; 400 900; 500 900; 600 900!; 700 9; 1100 900; 1200 900", ["500", "1200"]),
    "a second without any while it runs": ("7 4!; 8 0!; 1006 0!; 1007 0!; 1008 0!; 3000 0!", ["1007"]),
    "its electronics draw 5 mA": ("0 5!; 1000 5!; 2000 5!", []),
    "a pause begins the second anew": ("0 0!; 900 0!; 950 30!; 960 0!; 1900 0!; 1950 30!; 2000 900!", []),
}


@pytest.mark.parametrize(("measured", "reported"), CURRENTS.values(), ids=CURRENTS)
def test_what_a_servos_current_contradicts(measured: str, reported: list[str]) -> None:
    judged: dict[int, Judged] = {}
    found: list[str] = []
    for each in measured.split("; "):
        ms, ma = each.rstrip("!").split()
        runs = frozenset({11, 12} if "!" in each else ())
        for servo_id, kind, _ in findings(judged, {11: float(ma), 12: 100.0}, runs, int(ms) * NS_PER_MS):
            assert (servo_id, kind) == (11, Kind.SERVO_SILENT if runs else Kind.SERVO_DRAWS)
            found.append(ms)
    assert found == reported


# ---- Who waits for the power board


def test_some_wait_for_the_board_and_further_ones_learn_at_once_that_nothing_is_confirmed() -> None:
    asked: list[tuple[frozenset[int], int, Then, int]] = []
    board = SimpleNamespace(when_off=lambda *it: asked.append(it), want=lambda *_: None)
    line = SimpleNamespace(request=lambda act: act(board, 0), status=Status())
    supply = RobotSupply(
        cast(PowerLine, line), Supervisor(Rules(power=True)), cast(Wire, SimpleNamespace(ready_servos=None))
    )
    answers: dict[int, float | None] = {}
    for number in range(MOST_WAITING + 1):
        supply.confirm((11, 12), number, partial(answers.__setitem__, number))
    assert answers == {MOST_WAITING: None}
    assert [servos for servos, *_ in asked] == [frozenset({11, 12})] * MOST_WAITING
    supply.take_news([Confirmed(asked[7][2], 30.0), Confirmed(asked[8][2], None)])
    assert (answers[7], answers[8], len(answers)) == (30.0, None, 3)
    supply.close()
    assert (answers[7], len(answers)) == (30.0, MOST_WAITING + 1), "each learns it once"


def test_what_was_fed_before_the_latest_request_does_not_count() -> None:
    line = SimpleNamespace(request=lambda _: None, status=Status(alive=True, fed=frozenset({11})))
    supply = RobotSupply(
        cast(PowerLine, line), Supervisor(Rules(power=True)), cast(Wire, SimpleNamespace(ready_servos=None))
    )
    supply._ask(frozenset({11}))
    assert supply.take_news([])[0].fed == frozenset()
    line.status = line.status._replace(changes=1)
    assert supply.take_news([])[0].fed == {11}
