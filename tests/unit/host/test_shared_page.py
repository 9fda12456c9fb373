"""The page between a simulated body and a simulated controller: the newest reading, whole."""

from gateway.host.shared_page import Sensed, SensedPage, ServoPage


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


# ---- about simulated servos


def test_another_process_reads_what_was_written() -> None:
    writer = ServoPage()
    reader = ServoPage(writer.fd)
    writer.write(63, 12.25)
    writer.feed({11, 63})
    assert (reader.read()[63], reader.fed) == (12.25, frozenset((11, 63)))
