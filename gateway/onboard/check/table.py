"""The means of `check`: a probe reads something of this machine, and returns the first of its rows that applies.

A row is a call of `failure`, `warning` or `well`: when it is a fault, a sentence, a remedy. The remedy's commands work
as printed; a person fills in words in capitals. Probes that read the same are in one function.
"""

import json
import subprocess
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass, field
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import Any, Final, NamedTuple, Self

from rich.console import Console
from rich.text import Text

from gateway.errors import GatewayError
from gateway.onboard.computer import ROOT_DIR
from gateway.onboard.holders import Holder, OpenFiles
from gateway.people.terminal import say
from gateway.robot.settings import Settings
from gateway.words.text import visible

SERVICE: Final = "hexapod-gateway"
RESTART: Final = f"sudo systemctl reset-failed {SERVICE}; sudo systemctl restart {SERVICE}"
"""Works also after so many failed starts that systemd attempts no other."""
LET_READ: Final = "let the service read it, and nobody else: sudo hexapod-gateway setup"
_STYLES: Final = {"ok": "green", "PASS": "green", "warning": "yellow", "SKIPPED": "yellow"}
_BAD: Final = "bold red"


class Verdict(StrEnum):
    """`FAILURE`: the service does not start, or does not move the robot. `WARNING`: a person should know."""

    OK = "ok"
    WARNING = "warning"
    FAILURE = "failure"


class Result(NamedTuple):
    """One line: what was checked, the verdict, the sentence, and the remedy ("": none is needed)."""

    name: str
    verdict: Verdict
    sentence: str
    fix: str = ""


Row = tuple[Verdict, str, str] | None
"""Verdict, sentence and remedy; None: it does not apply."""


def _fault(verdict: Verdict, when: object, sentence: str, remedy: str) -> Row:
    return (verdict, sentence, remedy) if when else None


failure, warning = partial(_fault, Verdict.FAILURE), partial(_fault, Verdict.WARNING)


def held(what: str, others: Sequence[Holder], setting: str = "") -> Row:
    """Return the failure that these programs have `what`. `setting`: how to use another one."""
    ends = "; ".join(each.end for each in others)
    return failure(others, f"{what} is held by {', '.join(map(str, others))}, so the service cannot use it",
                   f"{setting}if that may end, with all legs stopped: {ends}; {RESTART}")  # fmt: skip


def well(sentence: str) -> Row:
    return Verdict.OK, sentence, ""


def first(name: str, *rows: Row) -> Result | None:
    """Return the line of a probe: the first row that applies."""
    return next((Result(name, *row) for row in rows if row is not None), None)


def shown(*arguments: str) -> dict[str, str]:
    """Return what `systemctl show` prints, with all values of a name joined; empty if it fails."""
    found, asked = dict[str, str](), ["systemctl", "show", *arguments]
    with suppress(OSError, subprocess.SubprocessError):
        lines = subprocess.run(asked, capture_output=True, text=True, check=True, timeout=5).stdout.splitlines()
        for name, _, value in (line.partition("=") for line in lines):
            found[name] = f"{found.get(name, '')} {value}".strip()
    return found


@dataclass
class CheckedRobot:
    """The machine that the probes read, and what they learn for each other. `root`, `shown`: replaced by tests."""

    settings: Settings = field(default_factory=Settings)
    root: Path = ROOT_DIR
    shown: Callable[..., dict[str, str]] = shown
    unit: Mapping[str, str] = field(default_factory=dict[str, str])
    """The service's properties in systemd; empty without any."""
    service: tuple[int, int] | None = None
    """The service's user and group ids; None if the user does not exist."""
    gateway_runs: bool = False
    """Whether a gateway holds the wire. Set by the wire's probe."""
    open_files: OpenFiles = field(default_factory=OpenFiles)

    def others(self, holders: Sequence[Holder]) -> list[Holder]:
        """Return the holders that are not the service; where none is installed, none while a gateway runs."""
        if self.gateway_runs and self.unit.get("LoadState") != "loaded":
            return []
        return [each for each in holders if str(each.pid) != self.unit.get("MainPID")]

    def path(self, absolute: str | Path) -> Path:
        """Return this path of the machine."""
        return self.root / str(absolute).lstrip("/")

    def text(self, absolute: str | Path) -> str:
        """Return the stripped text of a file of the machine; "" if it is unreadable or no file."""
        with suppress(OSError):
            return self.path(absolute).read_text(errors="replace").strip()
        return ""


Probes = Callable[[CheckedRobot], Iterator[Result | None]]


def results(robot: CheckedRobot, *probes: Probes) -> Iterator[Result]:
    """Yield the lines of all probes. A reading that this user may not take is a warning."""
    for read in probes:
        try:
            yield from filter(None, read(robot))
        except OSError as error:
            yield Result(read.__name__, Verdict.WARNING, f"cannot be read: {error}", "sudo hexapod-gateway check")


def show(name: str, word: str, sentence: str, fix: str = "") -> None:
    """Print `word  name  sentence → fix` in columns, in colour on a terminal. Never wrapped."""
    line = Text().append(f"{word:8}", _STYLES.get(word, _BAD)).append(f" {name:14} ", "bold").append(visible(sentence))
    Console(highlight=False, soft_wrap=True).print(line.append(f" → {visible(fix)}", "cyan") if fix else line)


def conclude(sentence: str, *, well: bool, as_json: Mapping[str, object] | None = None) -> int:
    """Print the last sentence, or `as_json` with `passed`. Return the exit code: 0 if `well`, else 1."""
    if as_json is None:
        Console(highlight=False, soft_wrap=True).print(Text(sentence, "bold green" if well else _BAD))
    else:
        say(json.dumps({"passed": well, **as_json}))
    return 0 if well else 1


# ---- the steps of --move, --stops and --wire


class FailedError(GatewayError):
    """A step failed; the message states what happened instead."""


class Skipped(GatewayError):  # noqa: N818  (it is no error)
    """A step cannot be done here; the message states why."""


def demand(true: object, sentence: str) -> None:
    """Raise FailedError with this sentence unless `true` holds."""
    if not true:
        raise FailedError(sentence)


class CheckStep(NamedTuple):
    """One step: its name, a sentence for a person, and its function. That returns figures, or a better sentence."""

    name: str
    does: str
    run: Callable[[Any], dict[str, Any] | str | None]

    @classmethod
    def of(cls, run: Callable[[Any], dict[str, Any]]) -> Self:
        """Return the step of a function: its name and docstring are the step's."""
        return cls(run.__name__.replace("_", "-"), str(run.__doc__).rstrip("."), run)

    def outcome(self, means: object, held: AbstractContextManager[object], *, quiet: bool = False) -> dict[str, object]:
        """Run it while `held`, and print the result unless `quiet`. Return it as `--json` prints it."""
        result, figures = "PASS", dict[str, Any]()
        try:
            with held:
                found = self.run(means)
            figures = found if isinstance(found, dict) else figures
            each = (f"{name} {value:{'.1f' if isinstance(value, float) else ''}}" for name, value in figures.items())
            detail = ", ".join(each) or str(found or self.does)
        except GatewayError as error:
            result, detail = "SKIPPED" if isinstance(error, Skipped) else "FAIL", str(error)
        except Exception as error:  # of a plug-in, which is somebody else's code
            result, detail = "FAIL", f"{type(error).__name__}: {error}"
        if not quiet:
            show(self.name, result, detail)
        return {"step": self.name, "result": result, "detail": detail, "figures": figures}


def ms_since(begun_s: float) -> float:
    return (time.monotonic() - begun_s) * 1000
