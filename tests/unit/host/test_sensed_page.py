"""The page between a simulated body and a simulated controller: the newest reading, whole."""

import mmap
import struct

from gateway.host.sensed_page import Sensed, SensedPage


def sensed(number: float) -> Sensed:
    """One whose 34 numbers all differ."""
    values = [number + place / 64 for place in range(34)]
    return Sensed(
        (values[0], values[1], values[2], values[3]),
        (values[4], values[5], values[6]),
        (values[7], values[8], values[9]),
        tuple(values[10:16]),
        tuple(values[16:]),
    )


def test_a_reader_in_another_process_finds_the_newest() -> None:
    writer = SensedPage()
    reader = SensedPage(writer.fd)
    assert reader.read() is None, "before the first"
    for number in (1.0, 2.0, 3.0):
        writer.write(sensed(number))
        assert reader.read() == sensed(number)


def test_the_newest_stays_whole_while_the_next_is_written() -> None:
    """A body that is killed in the middle of a reading has touched the older copy alone."""
    page = SensedPage()
    page.write(sensed(1.0))
    page.write(sensed(2.0))
    with mmap.mmap(page.fd, mmap.PAGESIZE) as memory:
        newest, older = (memory.find(struct.pack("=4d", *sensed(number)[0])) for number in (2.0, 1.0))
        kept = memory[newest : newest + 34 * 8]
        page.write(sensed(3.0))
        assert memory[newest : newest + 34 * 8] == kept
        assert memory[older : older + 32] == struct.pack("=4d", *sensed(3.0)[0])
        memory[newest : newest + 34 * 8] = bytes(34 * 8)  # now the older one, half of the next reading
    assert page.read() == sensed(3.0)
