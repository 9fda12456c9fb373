"""A score by mutants stands as long as the program is the same: tests/case/program.py."""

from pathlib import Path

import pytest

from tests.case import program

MODULE = '''"""A module."""

from a import b


def f(x: int) -> int:
    """A function."""
    return b(x) + 1  # one more
'''


@pytest.mark.parametrize(
    ("right", "wrong", "same"),
    [
        ("A function.", "Return one more.", True),
        ("  # one more", "", True),
        ("from a import b", "from c import b", True),
        ("+ 1", "+ 2", False),
        ("x: int", "x: float", False),
    ],
)
def test_words_leave_it_and_a_change_of_the_program_does_not(
    right: str, wrong: str, same: bool, tmp_path: Path
) -> None:
    for name, text in (("before", MODULE), ("after", MODULE.replace(right, wrong))):
        (tmp_path / name).write_text(text)
    assert (program.digest(tmp_path / "before") == program.digest(tmp_path / "after")) is same
