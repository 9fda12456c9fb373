"""The table of `check`: a probe reads something of this machine, and the first of its faults that holds is its line.

A new fault is a row: when what was read is a fault, the sentence, the remedy. Values of the reading fill in both texts.
A remedy's commands help as printed; a word in capitals is for a person to fill in.
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
"""Also after so many failed starts that systemd begins no other."""
INSTALL: Final = f"sudo apt install ./{SERVICE}_VERSION_ARCH.deb"
LET_READ: Final = (
    f"let the service read it, and nobody else: sudo chown -R root:{SERVICE} /etc/{SERVICE}; "
    f"sudo chmod -R u=rwX,g=rX,o= /etc/{SERVICE}; {RESTART}"
)
GOOD, NOTE, BAD = "green", "yellow", "bold red"


class Verdict(StrEnum):
    """`FAILURE`: the service would not start, or would not move the robot. `WARNING`: somebody should know it."""

    OK = "ok"
    WARNING = "warning"
    FAILURE = "failure"


class Result(NamedTuple):
    """One line: what was checked, the verdict, and what fixes it ("" if nothing needs fixing)."""

    name: str
    verdict: Verdict
    sentence: str
    fix: str = ""


def shown(*arguments: str) -> dict[str, str]:
    """What `systemctl show` prints, the values of one name together; nothing where it fails."""
    found = dict[str, str]()
    with suppress(OSError, subprocess.SubprocessError):
        asked = ["systemctl", "show", *arguments]
        lines = subprocess.run(asked, capture_output=True, text=True, check=True, timeout=5).stdout.splitlines()
        for name, _, value in (line.partition("=") for line in lines):
            found[name] = f"{found.get(name, '')} {value}".strip()
    return found


@dataclass
class CheckedRobot:
    """What the probes look at, and what they find out for each other. `root` and `shown`: a test's own machine."""

    settings: Settings = field(default_factory=Settings)
    root: Path = ROOT_DIR
    shown: Callable[..., dict[str, str]] = shown
    gateway_runs: bool = False
    """Whether a gateway holds the SPI device. The device's probe finds it out."""

    def path(self, absolute: str | Path) -> Path:
        """A path of the machine."""
        return self.root / str(absolute).lstrip("/")

    @property
    def installed(self) -> bool:
        """Whether the service is installed on this machine."""
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
        """What systemd shows of the service; nothing where it shows nothing."""
        return self.shown(SERVICE)

    @cached_property
    def environment(self) -> str:
        """The variables that systemd gives to all services."""
        return self.shown("--property=Environment").get("Environment", "")

    @cached_property
    def service(self) -> tuple[int, int] | None:
        """User and group of the service; None where there is no such user."""
        with suppress(KeyError):
            return pwd.getpwnam(SERVICE)[2:4]
        return None


def text(path: Path) -> str:
    """A file's text; "" where it is none, or not for this user to read."""
    with suppress(OSError):
        return path.read_text(errors="replace").strip()
    return ""


class Fault(NamedTuple):
    """A row of the table."""

    verdict: Verdict
    when: Callable[[Seen], object]
    sentence: str
    remedy: str


failure = partial(Fault, Verdict.FAILURE)
warning = partial(Fault, Verdict.WARNING)


class Probe(NamedTuple):
    """What is read: one thing, several, or None where it does not concern this machine. `well`: "" for no line."""

    name: str
    read: Callable[[Any], Seen | Iterable[Seen | None] | None]
    faults: tuple[Fault, ...]
    well: str = ""

    def readings(self, looked_at: object) -> Iterator[Seen]:
        """Read, and leave out what does not concern this machine."""
        found = self.read(looked_at) or ()
        yield from filter(None, [found] if isinstance(found, Seen) else found)

    def judged(self, seen: Seen) -> Iterator[Result]:
        """The line for one reading. `{run[check --move]}` is this program's command, with what reaches the gateway."""
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
    """Read each, and judge it. What this user may not look at is a warning."""
    for probe in probes:
        try:
            for seen in probe.readings(looked_at):
                yield from probe.judged(seen)
        except OSError as error:
            yield Result(probe.name, Verdict.WARNING, f"cannot be looked at: {error}", "sudo hexapod-gateway check")


def show(word: str, style: str, name: str, sentence: str, fix: str = "") -> None:
    """Print `word  name  sentence → fix` in columns, in colour on a terminal. It is never wrapped, for programs."""
    line = Text().append(f"{word:8}", style).append(f" {name:14} ", "bold").append(visible(sentence))
    Console(highlight=False, soft_wrap=True).print(line.append(f" → {visible(fix)}", "cyan") if fix else line)


def conclude(sentence: str, *, well: bool) -> int:
    """Print the sentence at the end; return the exit code."""
    Console(highlight=False, soft_wrap=True).print(Text(sentence, "bold green" if well else BAD))
    return 0 if well else 1
