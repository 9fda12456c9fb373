"""The page about simulated servos: where they are sent, and which of them have supply."""

from gateway.host.shared_page import ServoPage


def test_another_process_reads_what_was_written() -> None:
    writer = ServoPage()
    reader = ServoPage(writer.fd)
    writer.write(63, 12.25)
    writer.feed({11, 63})
    assert (reader.read()[63], reader.fed) == (12.25, frozenset((11, 63)))
