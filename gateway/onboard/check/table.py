"""The table of `check`: a probe reads something of this machine, and prints its first fault that applies.

A fault is a row: a condition on the reading, a sentence, a remedy. Values of the reading fill in both texts. The
remedy's commands work as printed; a person fills in words in capitals.
"""

import pwd
import subprocess
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cached_property, partial
from pathlib import Path
from types import SimpleNamespace as Seen
from typing import Any, Final, NamedTuple

from rich.console import Console
from rich.text import Text

from gateway.onboard import whole
from gateway.own_command import command
from gateway.robot.settings import Settings
from gateway.robot.spi.machine import ROOT_DIR
from gateway.text import visible

__all__ = ["Seen"]
SERVICE: Final = "hexapod-gateway"
RESTART: Final = f"sudo systemctl reset-failed {SERVICE}; sudo systemctl restart {SERVICE}"
"""Works also after so many failed starts that systemd attempts no other."""
INSTALL: Final = f"sudo apt install ./{SERVICE}_VERSION_ARCH.deb"
LET_READ: Final = (
    f"let the service read it, and nobody else: sudo chown -R root:{SERVICE} /etc/{SERVICE}; "
    f"sudo chmod -R u=rwX,g=rX,o= /etc/{SERVICE}; {RESTART}"
)
GOOD, NOTE, BAD = "green", "yellow", "bold red"


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


def shown(*arguments: str) -> dict[str, str]:
    """Return what `systemctl show` prints, with all values of a name joined; empty if it fails."""
    found = dict[str, str]()
    with suppress(OSError, subprocess.SubprocessError):
        asked = ["systemctl", "show", *arguments]
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
    gateway_runs: bool = False
    """Whether a gateway holds the SPI device. Set by the device's probe."""

    def path(self, absolute: str | Path) -> Path:
        """Return this path of the machine."""
        return self.root / str(absolute).lstrip("/")

    @property
    def installed(self) -> bool:
        """Whether the service is installed."""
        return self.path(whole.CURRENT).is_dir() or self.unit.get("LoadState") == "loaded"

    @cached_property
    def package(self) -> str:
        """The version of the installed package; "" without one."""
        return whole.version()

    @cached_property
    def files(self) -> whole.Whole:
        """The package's files, compared with dpkg's list."""
        return whole.compare() if self.package else whole.Whole()

    @cached_property
    def unit(self) -> Mapping[str, str]:
        """The service's properties in systemd; empty without any."""
        return self.shown(SERVICE)

    @cached_property
    def environment(self) -> str:
        """The variables that systemd gives to all services."""
        return self.shown("--property=Environment").get("Environment", "")

    @cached_property
    def service(self) -> tuple[int, int] | None:
        """The service's user and group ids; None if the user does not exist."""
        with suppress(KeyError):
            return pwd.getpwnam(SERVICE)[2:4]
        return None


def text(path: Path) -> str:
    """Return a file's stripped text; "" if it is unreadable or no file."""
    with suppress(OSError):
        return path.read_text(errors="replace").strip()
    return ""


class Fault(NamedTuple):
    """A row of the table. `when`: whether a reading has this fault."""

    verdict: Verdict
    when: Callable[[Seen], object]
    sentence: str
    remedy: str


failure = partial(Fault, Verdict.FAILURE)
warning = partial(Fault, Verdict.WARNING)


class Probe(NamedTuple):
    """`read` returns a reading, several, or None if none applies here. `well`: the line without a fault, if any."""

    name: str
    read: Callable[[Any], Seen | Iterable[Seen | None] | None]
    faults: tuple[Fault, ...]
    well: str = ""

    def readings(self, looked_at: object) -> Iterator[Seen]:
        """Yield the readings that apply to this machine."""
        found = self.read(looked_at) or ()
        yield from filter(None, [found] if isinstance(found, Seen) else found)

    def judged(self, seen: Seen) -> Iterator[Result]:
        """Yield the line of one reading. In texts, `{run[check --move]}` is a command with this connection."""
        values = {"run": _OwnCommands(), **vars(seen)}
        for fault in self.faults:
            if fault.when(seen):
                sentence, remedy = fault.sentence.format_map(values), fault.remedy.format_map(values).strip()
                yield Result(self.name, fault.verdict, sentence, remedy)
                return
        if self.well:
            yield Result(self.name, Verdict.OK, self.well.format_map(values))


class _OwnCommands:
    def __getitem__(self, arguments: str) -> str:
        return command(arguments)


def results(probes: Iterable[Probe], looked_at: object) -> Iterator[Result]:
    """Yield the lines of all probes. A reading that this user may not take is a warning."""
    for probe in probes:
        try:
            for seen in probe.readings(looked_at):
                yield from probe.judged(seen)
        except OSError as error:
            yield Result(probe.name, Verdict.WARNING, f"cannot be looked at: {error}", "sudo hexapod-gateway check")


def show(word: str, style: str, name: str, sentence: str, fix: str = "") -> None:
    """Print `word  name  sentence → fix` in columns, in colour on a terminal. Never wrapped."""
    line = Text().append(f"{word:8}", style).append(f" {name:14} ", "bold").append(visible(sentence))
    Console(highlight=False, soft_wrap=True).print(line.append(f" → {visible(fix)}", "cyan") if fix else line)


def conclude(sentence: str, *, well: bool) -> int:
    """Print the last sentence. Return the exit code: 0 if `well`, else 1."""
    Console(highlight=False, soft_wrap=True).print(Text(sentence, "bold green" if well else BAD))
    return 0 if well else 1
