"""When all six legs have been written a Stop."""

from tests.benchmarks.processes import Written

STOP_FRAME_OP = 2


def sixth_stop_us(written: list[Written], begun_ns: int) -> float | None:
    """From then until all six legs have been written a Stop since."""
    legs: set[int] = set()
    for transfer in written:
        if transfer.monotonic_ns >= begun_ns and len(transfer.data) == 14 and transfer.data[3] == STOP_FRAME_OP:
            legs.add(transfer.data[2] // 10)
            if len(legs) == 6:
                return (transfer.monotonic_ns - begun_ns) / 1000
    return None
