"""The simulated power board against what its firmware does, in passes of the main loop and in literal bytes."""

from collections.abc import Iterable

import pytest

from gateway.model.power_board import CanFrame
from gateway.simulation.board import MEASURE_NS, PASS_NS, SimulatedBoard

ALL = CanFrame(0x6A, bytes.fromhex("03ffff"))
NONE = CanFrame(0x6A, bytes(3))
ALL_ON = CanFrame(0x6B, bytes.fromhex("03ffff"))
TOO_MUCH_MA = 4000.0


def outputs(*numbers: int) -> int:
    return sum(1 << number - 1 for number in numbers)


def mask(*numbers: int) -> CanFrame:
    return CanFrame(0x6A, outputs(*numbers).to_bytes(3, "big"))


class Bench:
    """A board and its clock. A frame arrives in the pause behind a pass."""

    def __init__(self) -> None:
        self.now_ns = PASS_NS // 2
        self.board = SimulatedBoard()

    def take(self, frame: CanFrame) -> list[CanFrame]:
        return self.board.take(frame, self.now_ns)

    def ask(self, identifier: int) -> bytes:
        (answer,) = self.take(CanFrame(identifier))
        assert answer.id == identifier + 1
        return answer.data

    def passes(self, number: int) -> list[CanFrame]:
        """Let so many passes go by."""
        sent = []
        for _ in range(number):
            self.now_ns += PASS_NS
            sent += self.board.advance(self.now_ns)
        return sent

    def until(self, answer: int, most: int = 2000) -> tuple[int, CanFrame]:
        """After how many passes the first frame with this identifier comes, and the frame."""
        for number in range(1, most + 1):
            for frame in self.passes(1):
                if frame.id == answer:
                    return number, frame
        raise AssertionError(f"no {answer:02X} within {most} passes")

    def measure(self, times: int = 1) -> None:
        self.now_ns += times * MEASURE_NS
        self.said = self.board.advance(self.now_ns)


@pytest.fixture
def bench() -> Bench:
    return Bench()


@pytest.fixture
def fed(bench: Bench) -> Bench:
    """All outputs are on, long ago."""
    bench.take(ALL)
    bench.passes(1000)
    assert bench.board.fed == 0x3FFFF
    return bench


# ---- switching


def test_all_eighteen_go_on_one_by_one_in_494_passes(bench: Bench) -> None:
    bench.take(ALL)
    seen = []
    for _ in range(493):
        assert bench.passes(1) == []
        seen.append(bench.board.fed)
    assert [seen.index((1 << number) - 1) + 1 for number in range(1, 19)] == [26 * number for number in range(1, 19)]
    assert bench.passes(1) == [ALL_ON]


@pytest.mark.parametrize(("more", "passes"), [(0, 26 + 230), (9, 26 + 9 * 26 + 230)])
def test_a_mask_within_a_pass_behind_an_answer_waits_230_passes_longer(fed: Bench, more: int, passes: int) -> None:
    """What is to be off is off at once even then."""
    fed.take(NONE)
    fed.until(0x6B)
    wanted = range(1, more + 1)
    fed.take(mask(*wanted))
    assert fed.until(0x6B) == (passes, CanFrame(0x6B, mask(*wanted).data))
    assert {0: 256, 9: 490}[more] == passes


# ---- errors


def test_no_error_is_answered_without_bytes_in_the_next_pass(bench: Bench) -> None:
    assert bench.take(CanFrame(0x64)) == []
    assert bench.passes(5) == [CanFrame(0x65)]
    bench.take(CanFrame(0x96))
    assert bench.passes(5) == [], "there was nothing to delete"


def test_ten_measurements_above_the_limit_block_an_output_and_nine_do_not(fed: Bench) -> None:
    fed.board.draws_ma[4] = TOO_MUCH_MA
    fed.measure(9)
    fed.board.draws_ma[4] = 3900.0
    fed.measure()
    fed.board.draws_ma[4] = TOO_MUCH_MA
    fed.measure(9)
    assert fed.board.fed == 0x3FFFF
    fed.measure()
    assert fed.board.fed == 0x3FFFF & ~outputs(5)
    sent = fed.said + fed.passes(100)
    assert sent == [CanFrame(0x65, bytes.fromhex("02000010")), CanFrame(0x6B, bytes.fromhex("03ffef"))]
    fed.take(ALL)
    assert fed.until(0x6B)[1].data.hex() == "03ffef", "blocked whatever the mask"


def test_each_64_shows_the_next_error_and_96_deletes_the_one_shown_last(bench: Bench) -> None:
    bench.board.fail(8)
    bench.board.fail(2, outputs(1))
    shown = [bench.passes(1)[0].data.hex()]  # the newest unasked
    bench.board.fail(1, 1)
    shown += [bench.passes(1)[0].data.hex()]
    for _ in range(3):
        bench.take(CanFrame(0x64))
        shown.append(bench.passes(1)[0].data.hex())
    assert shown == ["02000001", "0101", "02000001", "08", "0101"]
    for left in ("08", "02000001", ""):  # it goes on behind the place of the one deleted
        bench.take(CanFrame(0x96))
        assert CanFrame(0x97) in bench.passes(1)
        bench.take(CanFrame(0x96))
        bench.take(CanFrame(0x64))
        (answer,) = (frame for frame in bench.passes(1) if frame.id != 0x6B)
        assert answer == CanFrame(0x65, bytes.fromhex(left)), "the second 96 deleted nothing"


@pytest.mark.parametrize(
    ("sensor", "data", "off"), [(0, "0407", range(1, 19)), (1, "0410", ()), (2, "0408", ())], ids=["1", "2", "3"]
)
def test_a_sensor_at_70_degrees_switches_converters_off_and_says_so_every_140_ms_while_that_lasts(
    fed: Bench, sensor: int, data: str, off: Iterable[int]
) -> None:
    fed.board.temperatures_c[sensor] = 69
    fed.measure(20)
    assert fed.said == []
    fed.board.temperatures_c[sensor] = 70
    fed.measure(43)  # 430 ms: at 10, 150, 290 and 430 ms
    errors = [frame.data.hex() for frame in fed.said + fed.passes(1) if frame.id == 0x65]
    assert errors == [data] * 4
    assert fed.board.fed == 0x3FFFF & ~outputs(*off)
    fed.board.temperatures_c[sensor] = 69
    fed.measure(20)
    fed.board.clear_by_hand()
    assert fed.board.fed == 0x3FFFF, "all that the newest mask has, at once"


# ---- its button, its own supply


def test_without_supply_it_forgets_everything_and_is_silent_until_its_button_is_pressed(fed: Bench) -> None:
    fed.board.fail(2, outputs(5))
    fed.board.restart()
    assert fed.board.fed == 0
    assert fed.take(CanFrame(0x70)) == fed.take(ALL) == fed.passes(2000) == []
    fed.board.press_button(fed.now_ns)
    fed.now_ns += 150_000_000
    assert fed.take(CanFrame(0x70)) == []
    fed.now_ns += 20_000_000
    assert fed.take(CanFrame(0x70)) == [CanFrame(0x71, bytes(6))]
    assert fed.passes(1000) == []
    assert fed.board.fed == 0
    fed.take(CanFrame(0x64))
    assert fed.passes(1) == [CanFrame(0x65)]


def test_66_takes_all_supply_after_1000_passes(fed: Bench) -> None:
    assert fed.take(CanFrame(0x66)) == [CanFrame(0x67)]
    fed.passes(999)
    assert fed.board.fed == 0x3FFFF
    fed.passes(2)
    assert fed.board.fed == 0
    assert fed.take(CanFrame(0x70)) == []
