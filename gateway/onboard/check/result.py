"""What every check returns."""

from dataclasses import dataclass
from enum import StrEnum


class Verdict(StrEnum):
    """`FAILURE`: the service would not start, or would not move the robot."""

    OK = "ok"
    WARNING = "warning"
    FAILURE = "failure"


@dataclass(frozen=True, slots=True)
class Result:
    """One line: what was checked, the verdict, and what fixes it ("" if nothing needs fixing)."""

    name: str
    verdict: Verdict
    sentence: str
    fix: str = ""


def ok(name: str, sentence: str) -> Result:
    """Nothing to fix."""
    return Result(name, Verdict.OK, sentence)


def warning(name: str, sentence: str, fix: str) -> Result:
    """The service runs, but somebody should know this."""
    return Result(name, Verdict.WARNING, sentence, fix)


def failure(name: str, sentence: str, fix: str) -> Result:
    """The service does not run like this."""
    return Result(name, Verdict.FAILURE, sentence, fix)
