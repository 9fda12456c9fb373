"""The page about simulated servos: where they are sent, and which of them have supply."""

from gateway.host.servo_page import ServoPage
from schemas.robot import SERVO_IDS


def test_all_are_off_and_fed_at_first() -> None:
    page = ServoPage()
    assert page.read() == dict.fromkeys(SERVO_IDS)
    assert page.fed == frozenset(SERVO_IDS)


def test_another_process_reads_what_was_written() -> None:
    writer = ServoPage()
    reader = ServoPage(writer.fd)
    writer.write(63, 12.25)
    writer.feed({11, 63})
    assert (reader.read()[63], reader.fed) == (12.25, frozenset((11, 63)))


def test_a_servo_without_supply_is_off_and_goes_where_it_was_sent_once_it_is_fed() -> None:
    page = ServoPage()
    page.write(21, 80.0)
    page.write(22, 90.0)
    page.feed({22, 31})
    assert page.read() == {**dict.fromkeys(SERVO_IDS), 22: 90.0}
    page.feed(SERVO_IDS)
    assert page.read() == {**dict.fromkeys(SERVO_IDS), 21: 80.0, 22: 90.0}
