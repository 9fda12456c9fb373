"""Of several nodes that publish on one topic, the first is followed until it is silent."""

from gateway.people.ros2.rivals import SILENT_S, Rivals

A, B = b"a" * 16, b"b" * 16


def test_the_first_is_followed_until_it_is_silent() -> None:
    rivals = Rivals()
    assert rivals.may_send(B, 0.0), "nobody has sent"
    rivals.sent(A, 10.0)
    assert rivals.may_send(A, 10.1)
    assert not rivals.may_send(B, 10.1)
    rivals.sent(A, 10.2)
    assert not rivals.may_send(B, 10.2 + SILENT_S)
    assert rivals.may_send(B, 10.3 + SILENT_S)
    rivals.sent(B, 10.3 + SILENT_S)
    assert not rivals.may_send(A, 10.4 + SILENT_S), "and now the other"


def test_a_graph_that_reports_no_senders_has_one() -> None:
    rivals = Rivals()
    rivals.sent(b"", 10.0)
    assert rivals.may_send(b"", 10.0)
