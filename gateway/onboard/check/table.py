"""The table of `check`: a probe reads something of this machine, and the first of its faults that holds is its result.

A new fault is a row: when what was read is a fault, the sentence, the remedy. Values of the reading fill in both texts.
A remedy's commands help as printed; a word in capitals is for a person to fill in.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import partial
from pathlib import Path
from types import SimpleNamespace as Seen
from typing import Any, Final, NamedTuple

from gateway.own_command import command
from gateway.robot.settings import Settings
from gateway.robot.spi.machine import ROOT_DIR

__all__ = ["Seen"]
SERVICE: Final = "hexapod-gateway"
RESTART: Final = f"sudo systemctl reset-failed {SERVICE}; sudo systemctl restart {SERVICE}"
"""Also after so many failed starts that systemd begins no other."""
INSTALL: Final = "sudo deploy/install.sh"
ETC: Final = f"/etc/{SERVICE}"
LET_READ: Final = (
    f"let the service read it, and nobody else: sudo chown -R root:{SERVICE} {ETC}; "
    f"sudo chmod -R u=rwX,g=rX,o= {ETC}; {RESTART}"
)


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


@dataclass
class CheckedRobot:
    """What the probes look at, and what they find out for each other."""

    settings: Settings
    root: Path = ROOT_DIR
    """Where the kernel's files are: another folder in tests."""
    gateway_runs: bool = False
    """Whether a gateway holds the SPI device. The device's probe finds it out."""
    installed: bool = False


class Fault(NamedTuple):
    """A row of the table."""

    verdict: Verdict
    when: Callable[[Seen], object]
    sentence: str
    remedy: str


failure = partial(Fault, Verdict.FAILURE)
warning = partial(Fault, Verdict.WARNING)


class Probe(NamedTuple):
    """What is read: nothing where it does not concern this machine, or several things. `well`: "" for no line."""

    name: str
    read: Callable[[Any], Iterable[Seen]]
    faults: tuple[Fault, ...]
    well: str = ""


def results(probes: Sequence[Probe], looked_at: object) -> Iterator[Result]:
    """Read each, and judge it."""
    for probe in probes:
        for seen in probe.read(looked_at):
            yield from judged(probe, seen)


def judged(probe: Probe, seen: Seen) -> Iterator[Result]:
    """The line for one reading."""
    values = {"run": _OwnCommands(), **vars(seen)}
    for fault in probe.faults:
        if fault.when(seen):
            yield Result(
                probe.name, fault.verdict, fault.sentence.format_map(values), fault.remedy.format_map(values).strip()
            )
            return
    if probe.well:
        yield Result(probe.name, Verdict.OK, probe.well.format_map(values))


class _OwnCommands:
    """`{run[check --move]}` in a text is this program's command, with what it needs to reach the gateway."""

    def __getitem__(self, arguments: str) -> str:
        return command(arguments)


def always(_: Seen) -> bool:
    """That a reading exists is the fault."""
    return True
