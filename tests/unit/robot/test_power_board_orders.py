"""The power board in any order of wants, cuts, faults of the link and of the board: what holds after each event."""

from typing import Final

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from gateway.allowance import NS_PER_MS
from gateway.model.power_board import ALL, SET_SUPPLY
from schemas.robot import SERVO_IDS
from tests.support.power_link import ALL_SERVOS, FLIGHT_NS, NONE, Link

SETS: Final = st.sampled_from(
    [frozenset(), ALL_SERVOS, frozenset({11}), frozenset({11, 12, 13}), ALL_SERVOS - {11}, ALL_SERVOS - {61, 62, 63}]
)
LATE_NS: Final = 3 * FLIGHT_NS
"""An off takes so long to reach the board's pins."""
STEPS: Final = st.lists(
    st.tuples(
        st.sampled_from(
            ["want", "want", "want", "cut", "cut", "off", "pause", "resume", "blocked", "by hand", "clear", "restart"]
        ),
        SETS,
        st.sampled_from([0.0, 0.1, 1.0, 7.0, 20.0, 37.5, 39.0, 40.5, 60.0, 150.0, 700.0]),
    ),
    max_size=25,
)


class Watched(Link):
    """Checks after each event that nothing comes on unasked, and that what is confirmed to be off is off."""

    def __init__(self, faults: float, seed: int, pass_ns: int) -> None:
        super().__init__(faults=faults, seed=seed, pass_ns=pass_ns)
        self.alters = False
        self.wanted: frozenset[int] = frozenset()
        self.unwanted_ns = dict.fromkeys(SERVO_IDS, -LATE_NS)
        """Since when each servo is not wanted."""
        self.lost_ns: dict[int, int] = {}
        """Since when we know of an answering board that it switched a servo off; a silent one may still obey a mask."""
        self.before = 0
        self.newest: tuple[int, int, int] = (0, 0, 0)
        """How many masks were sent, when the newest one was, and what it has."""
        self.been_on = 0
        """What was fed since then: the first time, the board only carries that mask out."""
        self.watch = self.check

    def say_want(self, servos: frozenset[int]) -> None:
        for servo in self.wanted - servos:
            self.unwanted_ns[servo] = self.now_ns
        self.wanted = servos

    def check(self) -> None:
        came_on = self.board.fed & ~self.before
        self.before = self.board.fed
        masks = [(at_ns, frame) for at_ns, frame in self.sent if frame.id == SET_SUPPLY]
        if len(masks) != self.newest[0]:
            at_ns, frame = masks[-1]
            self.newest = len(masks), at_ns, int.from_bytes(frame.data, "big")
            self.been_on = self.board.fed & ~came_on
        _, sent_ns, mask = self.newest
        lost = self.ours.status.lost if self.ours.alive else ()
        self.lost_ns = {servo: self.lost_ns.get(servo, self.now_ns) for servo in lost}
        for place, servo in enumerate(SERVO_IDS):
            bit = 1 << place
            if came_on & bit and servo not in self.wanted:
                assert self.now_ns - self.unwanted_ns[servo] <= LATE_NS, f"{servo} came on unasked"
            carried_out = mask & bit and not self.been_on & bit and sent_ns <= self.lost_ns.get(servo, self.now_ns)
            if came_on & bit and not carried_out:
                assert self.now_ns - self.lost_ns.get(servo, self.now_ns) <= LATE_NS, f"{servo} came on again"
        self.been_on |= self.board.fed
        if self.ours.confirmed:
            assert not self.fed() - self.ours.status.lost - self.wanted, "what is confirmed to be off is on"


@pytest.mark.full
@settings(max_examples=40, deadline=None)
@given(STEPS, st.sampled_from([0.0, 0.2]), st.integers(0, 1000), st.sampled_from([1_000_000, 1_500_000, 2_000_000]))
# A silence ends while the board still carries the mask of before out.
@example(
    [
        ("want", NONE, 40.5),
        ("pause", NONE, 40.5),
        ("want", ALL_SERVOS, 60.0),
        ("clear", NONE, 0.0),
        ("resume", NONE, 20.0),
    ],
    0.0,
    0,
    1_000_000,
)
# Six questions are lost: four while the board starts, two by the link.
@example([("pause", NONE, 39.0), ("restart", NONE, 0.1), ("resume", NONE, 20.0)], 0.2, 59, 1_000_000)
def test_nothing_comes_on_unasked_and_what_is_confirmed_is_so(
    steps: list[tuple[str, frozenset[int], float]], faults: float, seed: int, pass_ns: int
) -> None:
    link = Watched(faults, seed, pass_ns)
    cut = False
    for token, (step, servos, ms) in enumerate(steps):
        match step:
            case "want":
                cut = cut and bool(servos)
                link.say_want(frozenset() if cut else servos)
                link.want(servos)
            case "cut":
                cut = True
                link.say_want(frozenset())
                link.cut()
            case "off":
                link.when_off(servos, token)
            case "pause":
                link.pause()
            case "resume":
                link.resume()
            case "blocked":
                link.board.fail(2, 1 << (token % 18))
            case "by hand":
                link.board.clear_by_hand()
            case "clear":
                link.ours.clear_errors(link.now_ns)
            case _:
                link.board.restart()
                link.before = 0
                link.board.press_button(link.now_ns)
        link.run(ms)
    link.resume()
    # Whatever was: an emergency stop takes all, and is confirmed.
    link.say_want(frozenset())
    link.cut()
    link.run(0.3)
    assert link.board.fed == 0 or not link.ours.alive
    link.run(4000)
    assert link.ours.confirmed
    assert link.ours.alive
    # And what is wanted anew comes back, unless the board has blocked it.
    link.ours.clear_errors(link.now_ns)
    link.run(2500)
    link.say_want(ALL_SERVOS)
    link.want_anew(ALL_SERVOS)
    link.run(2500)
    assert link.board.fed == ALL
    assert link.now_ns > NS_PER_MS
