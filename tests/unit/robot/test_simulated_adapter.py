"""The simulated CAN adapter: slcan byte by byte, and the faults between it and the board."""

import pytest

from gateway.model.power_board import CanFrame
from gateway.simulation.board_port import SimulatedAdapter, frame_of


@pytest.fixture
def adapter() -> SimulatedAdapter:
    """With an open channel."""
    adapter = SimulatedAdapter()
    assert adapter.take(b"C\rS8\r\rO\r") == ([], b"\r\r\r\r")
    return adapter


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


def test_bytes_come_in_any_portions_and_an_endless_line_does_no_harm(adapter: SimulatedAdapter) -> None:
    assert [adapter.take(bytes((byte,)))[0] for byte in b"t0700\r"] == [[]] * 5 + [[CanFrame(0x70)]]
    assert adapter.take(b"0" * 100_000 + b"\rt0700\r") == ([CanFrame(0x70)], b"\a\r")
