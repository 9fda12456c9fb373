"""The simulated CAN adapter: slcan byte by byte, and the faults between it and the board."""

import pytest

from gateway.model.power_board import CanFrame
from gateway.robot.power.simulated_adapter import SimulatedAdapter, SimulatedLink, frame_of, text_of

MS = 1_000_000  # ns
MASK = CanFrame(0x6A, bytes.fromhex("03ffff"))


@pytest.fixture
def adapter() -> SimulatedAdapter:
    """With an open channel."""
    adapter = SimulatedAdapter()
    assert adapter.take(b"C\rS8\r\rO\r") == ([], b"\r\r\r\r")
    return adapter


@pytest.mark.parametrize(
    ("frame", "text"),
    [
        (MASK, b"t06A303FFFF\r"),
        (CanFrame(0x70), b"t0700\r"),
        (CanFrame(0x7FF, bytes(range(8))), b"t7FF8" + b"0001020304050607\r"),
    ],
)
def test_a_frame_is_its_text_both_ways(adapter: SimulatedAdapter, frame: CanFrame, text: bytes) -> None:
    assert text_of(frame) == adapter.text(frame) == text
    assert adapter.take(text) == ([frame], b"\r")


@pytest.mark.parametrize(
    "line",
    [
        "t06A",
        "t06A3",
        "t06A303FF",
        "t06A303FFFFFF",
        "t06A9" + 18 * "0",
        "t8000",
        "txyz0",
        "t06A3gg0000",
        "x",
        "t06A2 03 FF",
    ],
)
def test_a_line_that_is_none_puts_nothing_on_the_bus(adapter: SimulatedAdapter, line: str) -> None:
    assert adapter.take(line.encode() + b"\rt0700\r") == ([CanFrame(0x70)], b"\a\r")
    assert frame_of(line.encode()) is None


def test_frames_of_other_kinds_are_taken_and_do_not_reach_the_board(adapter: SimulatedAdapter) -> None:
    assert adapter.take(b"r0700\rT0000007000\rR000000700\r") == ([], b"\r\r\r")


def test_bytes_come_in_any_portions_and_an_endless_line_does_no_harm(adapter: SimulatedAdapter) -> None:
    assert [adapter.take(bytes((byte,)))[0] for byte in b"t0700\r"] == [[]] * 5 + [[CanFrame(0x70)]]
    assert adapter.take(b"0" * 100_000 + b"\rt0700\r") == ([CanFrame(0x70)], b"\a\r")


def test_a_channel_that_is_closed_or_only_listens_sends_nothing(adapter: SimulatedAdapter) -> None:
    closed = SimulatedAdapter()
    assert closed.take(b"t0700\r") == ([], b"\a")
    assert closed.text(MASK) == b""
    assert closed.take(b"L\rt0700\rS8\rO\r") == ([], b"\r\a\a\a")
    assert closed.text(MASK) == b"t06A303FFFF\r"
    adapter.take(b"C\r")
    assert adapter.text(MASK) == b""


def test_questions_about_itself_are_answered(adapter: SimulatedAdapter) -> None:
    assert adapter.take(b"V\rN\rF\r") == ([], b"V1013\rNSIM1\rF00\r")


# ---- between board and adapter


def frames(number: int) -> list[CanFrame]:
    return [CanFrame(0x71, bytes((place,))) for place in range(number)]


def test_without_faults_all_arrives_at_once() -> None:
    link = SimulatedLink()
    for frame in frames(5):
        link.send(frame, 0)
    assert link.arrived(0) == frames(5)
    assert len(link) == 0


def test_a_pause_holds_all_back_and_gives_it_all_at_once() -> None:
    link = SimulatedLink()
    link.pause(500 * MS)
    for place, frame in enumerate(frames(5)):
        link.send(frame, place * MS)
    assert link.arrived(500 * MS - 1) == []
    assert link.due_ns == 500 * MS
    assert link.arrived(500 * MS) == frames(5)


def through(link: SimulatedLink) -> tuple[list[CanFrame], list[CanFrame], list[CanFrame]]:
    """200 frames, and which of them arrive at once, and late."""
    sent = frames(200)
    for frame in sent:
        link.send(frame, 0)
    return sent, link.arrived(0), link.arrived(link.delay_ns)


def test_a_share_of_the_frames_is_lost() -> None:
    link = SimulatedLink(seed=1)
    link.lose = 0.2
    sent, at_once, late = through(link)
    assert not late
    assert len(at_once) in range(145, 176)
    assert at_once == [frame for frame in sent if frame in at_once], "in their order"


def test_a_share_of_the_frames_is_wrong() -> None:
    link = SimulatedLink(seed=1)
    link.corrupt = 0.2
    sent, at_once, late = through(link)
    assert not late
    wrong = [frame for frame, was in zip(at_once, sent, strict=True) if frame != was]
    assert len(wrong) in range(25, 56)
    assert {len(frame.data) for frame in wrong} == {1, 2}


def test_a_share_of_the_frames_is_late_and_holds_back_those_behind_it() -> None:
    link = SimulatedLink(seed=1)
    link.delay = 0.01
    sent, at_once, late = through(link)
    assert at_once
    assert late
    assert at_once + late == sent
