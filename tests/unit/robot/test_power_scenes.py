"""What the power board is sent, feeds and confirms, scene by scene: against the simulated board, in virtual time."""

from collections.abc import Callable
from typing import Final

import pytest

from gateway.model.power_board import SUPPLIED, SUPPLY_LOW, CanFrame, set_supply
from gateway.simulation.board import SimulatedBoard
from schemas.robot import SERVO_IDS
from schemas.telemetry import Kind
from tests.support.power_link import ALL_SERVOS, Link, fed


def servos(words: str) -> frozenset[int]:
    """`all`, `none`, `11,12` or `all-11,12`."""
    whole, _, without = words.partition("-")
    found = ALL_SERVOS if whole == "all" else frozenset(map(int, whole.split(","))) if whole != "none" else frozenset()
    return found - (servos(without) if without else frozenset())


def mask(words: str) -> int:
    return sum(1 << SERVO_IDS.index(servo) for servo in servos(words))


def _alter(link: Link, shown: int | None) -> None:
    """Masks in the board's answers show these outputs on as well; None: they are lost."""

    def altered(frame: CanFrame) -> CanFrame:
        if frame.id != SUPPLIED:
            return frame
        lost, known = CanFrame(0x100), int.from_bytes(frame.data, "big")
        return lost if shown is None else set_supply(known | shown)._replace(id=SUPPLIED)

    link.altered = altered


def _second(link: Link) -> None:
    """A second board on the bus answers what the first one does."""
    link.second = SimulatedBoard(link.now_ns)


def _repeat(link: Link, words: str) -> None:
    """`4000 0.25 hears 69`: so often, with so many milliseconds behind each."""
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
    """Lines of `what is done; … → what is then so; …`."""
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
