"""Foreign text on one line."""

import pytest

from gateway.text import visible


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("Zoë drives 火星", "Zoë drives 火星"),
        ('it\'s "C:\\"\a', r"""it's "C:\"\x07"""),
        ("eve\x1b[2J\nok\r", r"eve\x1b[2J\nok\r"),
        ("\x00\x7f\x9b\u2028\ud800\U000e0001", r"\x00\x7f\x9b\u2028\ud800\U000e0001"),
    ],
)
def test_what_cannot_be_printed_is_escaped(text: str, shown: str) -> None:
    assert visible(text) == shown
