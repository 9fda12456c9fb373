"""What may be wrong with an installation, as one table: how it shows, the sentence, the remedy.

Pure: `looking.py` gathers what is judged here. A remedy's commands go from its first `sudo` to the end of the line and
help as printed; `tests/box/test_check_faults.py` follows each. A placeholder in capitals is for a person to fill in.
"""

import shlex
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import PurePosixPath as Path
from typing import Final, NamedTuple

from gateway.onboard.check.result import Result, Verdict
from gateway.onboard.whole import SHOWN, Whole

SERVICE: Final = "hexapod-gateway"
STATE_FOLDER: Final = f"/var/lib/{SERVICE}"
ETC: Final = f"/etc/{SERVICE}"
UNITS: Final = (SERVICE,)

RESTART: Final = f"sudo systemctl reset-failed {SERVICE}; sudo systemctl restart {SERVICE}"
"""Also after so many failed starts that systemd begins no other."""
_RELOAD: Final = f"sudo systemctl daemon-reload && {RESTART}"
_ASIDE: Final = "stop the robot, then put it aside: sudo mv {0} {0}.off && " + _RELOAD
_OWN_STATE: Final = (
    f"sudo chown -R {SERVICE}:{SERVICE} {STATE_FOLDER} && sudo chmod -R u+rwX {STATE_FOLDER} && {RESTART}"
)
_SPI: Final = "sudo udevadm control --reload; sudo udevadm trigger --subsystem-match=spidev"


class Shipped(NamedTuple):
    """A file that the installer copies out of the release, which has it under `source`."""

    source: str
    place: str
    after: str
    """What makes a new one take effect."""


SHIPPED: Final = (
    Shipped(
        f"systemd/{SERVICE}.service",
        f"/etc/systemd/system/{SERVICE}.service",
        f"sudo systemctl daemon-reload && sudo systemctl enable {SERVICE} && {RESTART}",
    ),
    Shipped(f"udev/60-{SERVICE}.rules", f"/etc/udev/rules.d/60-{SERVICE}.rules", _SPI),
)

# fmt: off
_DEPENDS: Final = frozenset({
    "Type", "NotifyAccess", "User", "Group", "DynamicUser", "SupplementaryGroups", "RootDirectory",
    "WorkingDirectory", "ExecStart", "ExecStartPre", "ExecStop", "ExecStopPost", "RuntimeDirectory",
    "RuntimeDirectoryMode", "RuntimeDirectoryPreserve", "StateDirectory", "StateDirectoryMode", "WatchdogSec",
    "WatchdogSignal", "KillMode", "KillSignal", "FinalKillSignal", "SendSIGKILL", "Restart", "RestartSec",
    "RestartPreventExitStatus", "TimeoutStartSec", "TimeoutStopSec", "TimeoutAbortSec", "TimeoutSec", "LimitRTPRIO",
    "LimitNICE", "Nice", "DevicePolicy", "DeviceAllow", "PrivateDevices", "SystemCallFilter", "RestrictRealtime",
    "CPUQuota", "CPUSchedulingPolicy", "EnvironmentFile", "ReadOnlyPaths", "InaccessiblePaths"
})
# fmt: on
"""What the service's Stops, or those after its end, depend on; else a person may change what they like."""


class DropIn(NamedTuple):
    """A file that changes a unit: its assignments, in order."""

    path: str
    assigned: tuple[tuple[str, str], ...]

    @classmethod
    def of(cls, path: str, text: str) -> "DropIn":
        """Read as systemd does: a backslash at the end continues a line, # and ; begin comments."""
        lines = text.replace("\\\n", " ").splitlines()
        given = (line.strip().partition("=") for line in lines if line.strip() and line.strip()[0] not in "#;[")
        return cls(path, tuple((key.strip(), value.strip()) for key, _, value in given))

    @property
    def keys(self) -> frozenset[str]:
        return frozenset(key for key, _ in self.assigned)

    @property
    def environment(self) -> str:
        """All that it sets of the service's variables."""
        return " ".join(value for key, value in self.assigned if key == "Environment")

    @property
    def simulates(self) -> bool:
        return "--sim" in self.environment

    @property
    def stops_nothing(self) -> bool:
        """Whether nothing is left that stops the servos after the service's end."""
        after = [value for key, value in self.assigned if key == "ExecStopPost"]
        return "" in after and not any("stop-servos" in each for each in after[after.index("") :])


@dataclass(frozen=True)
class Folder:
    """The service's state directory, and what in it is not the service's own."""

    is_folder: bool = True
    owned: bool = True
    writable: bool = True
    foreign: tuple[str, ...] = ()
    read_only_mount: str = ""


@dataclass(frozen=True)
class Installation:
    """What there is of an installation. `units`: what systemd shows of each."""

    release: str
    """The folder of the release that is installed."""
    deploy: str
    """The files that it ships, in it."""
    again: str
    """The commands that install it once more."""
    whole: Whole = field(default_factory=lambda: Whole(listed=True))
    differ: Mapping[str, str] = field(default_factory=dict)
    """Of `Shipped.place`: why it is not as shipped."""
    units: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    drop_ins: tuple[DropIn, ...] = ()
    state: Folder = field(default_factory=Folder)
    user: bool = True
    groups: tuple[str, ...] = ()
    """Those that are missing."""
    exposed: tuple[str, ...] = ()
    """Private keys that others than root and the service may read."""
    authority_keys: tuple[str, ...] = ()
    command: str = ""
    """Where the command leads that is not this release's."""

    def shows(self, unit: str, name: str) -> str:
        """A unit's property, as `systemctl show` has it; "" if unknown."""
        return self.units.get(unit, {}).get(name, "")


_Found = Iterable[tuple[str, ...]]


@dataclass(frozen=True)
class Fault:
    """A row: what `found` yields goes into `sentence` and `remedy`, a result each."""

    name: str
    verdict: Verdict
    found: Callable[[Installation], _Found]
    sentence: str
    remedy: str


def results(seen: Installation) -> Iterator[Result]:
    """What is wrong, in the table's order; nothing where all is well."""
    for fault in FAULTS:
        for given in fault.found(seen):
            yield Result(fault.name, fault.verdict, fault.sentence.format(*given), fault.remedy.format(*given))


def _when(condition: bool, *given: str) -> _Found:
    return [given] if condition else []


def _some(names: tuple[str, ...], seen: Installation, *more: str) -> _Found:
    """A few names in one sentence."""
    rest = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
    return _when(bool(names), f"{', '.join(names[:SHOWN])}{rest}", seen.again, seen.release, *more)


def _differing(seen: Installation) -> _Found:
    for each in SHIPPED:
        why = seen.differ.get(each.place)
        if why is not None and not _is_masked(seen, Path(each.place).stem):
            yield each.place, why, str(Path(seen.deploy, each.source)), each.after


def _is_masked(seen: Installation, unit: str) -> bool:
    return seen.shows(unit, "LoadState") == "masked"


def _masked(seen: Installation) -> _Found:
    for each in SHIPPED:
        unit = Path(each.place).stem
        if _is_masked(seen, unit):
            yield unit, each.place, str(Path(seen.deploy, each.source)), each.after


def _drop_ins(wanted: Callable[[DropIn], bool]) -> Callable[[Installation], _Found]:
    """Each drop-in is named once, by what is worst of it."""
    return lambda seen: [
        (each.path, each.environment, ", ".join(sorted(each.keys & _DEPENDS))) for each in seen.drop_ins if wanted(each)
    ]


def _sets_settings(each: DropIn) -> bool:
    return "HEXAPOD_" in each.environment and not (each.simulates or each.stops_nothing)


def _changes_what_stops_depend_on(each: DropIn) -> bool:
    return bool(each.keys & _DEPENDS) and not (each.simulates or each.stops_nothing or _sets_settings(each))


FAULTS: Final = (
    Fault(
        "release",
        Verdict.FAILURE,
        lambda seen: _some(seen.whole.changed, seen),
        "not as installed in {2}: {0}. The service, or its Stops after a crash, may fail",
        "{1}",
    ),
    Fault(
        "release",
        Verdict.FAILURE,
        lambda seen: _when(not seen.whole.listed, seen.release, seen.again),
        "{0} has no list of its files, so nobody knows whether it is whole",
        "{1}",
    ),
    Fault(
        "release",
        Verdict.WARNING,
        lambda seen: _some(seen.whole.added, seen, shlex.join(f"{seen.release}/{each}" for each in seen.whole.added)),
        "in {2}, and not installed with it: {0}. Python may load it",
        "sudo rm {3}",
    ),
    Fault(
        "release",
        Verdict.FAILURE,
        lambda seen: _some(seen.whole.closed, seen),
        "in {2}, not for all to read, or not for root alone to write: {0}",
        "sudo chown -R root:root {2} && sudo chmod -R u+rwX,go+rX,go-w {2} && " + RESTART,
    ),
    Fault(
        "command",
        Verdict.WARNING,
        lambda seen: _when(bool(seen.command), seen.command),
        f"/usr/local/bin/{SERVICE} {{0}}: commands are another release's than the service",
        f"sudo ln -sfnT /opt/{SERVICE}/venv/bin/{SERVICE} /usr/local/bin/{SERVICE}",
    ),
    Fault(
        "user",
        Verdict.FAILURE,
        lambda seen: _when(not seen.user, seen.again),
        f"there is no user {SERVICE}, so the service cannot start, nor stop the servos after its end",
        "{0}",
    ),
    Fault(
        "group",
        Verdict.FAILURE,
        lambda seen: [(each,) for each in seen.groups],
        "there is no group {0}, so the service cannot start, nor stop the servos after its end",
        f"sudo groupadd --system {{0}} && sudo usermod -aG {{0}} {SERVICE} && sudo chgrp {{0}} /dev/spidev* && "
        + RESTART,
    ),
    Fault(
        "systemd unit",
        Verdict.FAILURE,
        _masked,
        "{0} is masked, or its unit is empty: it cannot start",
        "sudo systemctl unmask {0} && sudo install -m 644 {2} {1} && {3}",
    ),
    Fault(
        "installed file",
        Verdict.FAILURE,
        _differing,
        "{0} {1} (changes belong into a drop-in: systemctl edit)",
        "stop the robot, then: sudo install -D -m 644 {2} {0} && {3}",
    ),
    Fault(
        "systemd unit",
        Verdict.FAILURE,
        lambda seen: [(each,) for each in UNITS if seen.shows(each, "NeedDaemonReload") == "yes"],
        "{0} was edited, and systemd still goes by what was there before",
        "stop the robot, then: sudo systemctl daemon-reload && sudo systemctl restart {0}",
    ),
    Fault(
        "drop-in",
        Verdict.WARNING,
        _drop_ins(lambda each: each.simulates),
        "{0} makes the controller a simulated one: the service moves no robot, and stops none after its end",
        "before the robot is to move: " + _ASIDE.partition(": ")[2],
    ),
    Fault(
        "drop-in",
        Verdict.FAILURE,
        _drop_ins(lambda each: each.stops_nothing and not each.simulates),
        "{0} empties ExecStopPost=: nothing stops the servos if the gateway dies",
        _ASIDE,
    ),
    Fault(
        "drop-in",
        Verdict.WARNING,
        _drop_ins(_sets_settings),
        "{0} has settings, which hold in place of gateway.toml: {1}",
        "write them there, and " + _ASIDE,
    ),
    Fault(
        "drop-in",
        Verdict.WARNING,
        _drop_ins(_changes_what_stops_depend_on),
        "{0} changes what Stops depend on: {2}",
        "if nobody knows why, " + _ASIDE,
    ),
    Fault(
        "state",
        Verdict.FAILURE,
        lambda seen: _when(not seen.state.is_folder, STATE_FOLDER),
        "{0} is no folder: the service cannot start, nor stop the servos after its end",
        "sudo mv {0} {0}.old && " + RESTART,
    ),
    Fault(
        "state",
        Verdict.FAILURE,
        lambda seen: _when(bool(seen.state.read_only_mount), STATE_FOLDER, seen.state.read_only_mount),
        "{0} is on a file system that is read-only: no calibration or list is kept",
        "see why (dmesg), then: sudo mount -o remount,rw {1}",
    ),
    Fault(
        "state",
        Verdict.FAILURE,
        lambda seen: _when(
            not (seen.state.owned and seen.state.writable) and seen.state.is_folder and not seen.state.read_only_mount,
            STATE_FOLDER,
        ),
        "{0} is not the service's to write: it may not start, nor stop the servos after its end",
        _OWN_STATE,
    ),
    Fault(
        "state",
        Verdict.FAILURE,
        lambda seen: _some(seen.state.foreign, seen) if seen.state.owned else (),
        f"in {STATE_FOLDER}, not the service's to read and write: {{0}}",
        _OWN_STATE,
    ),
    Fault(
        "private key",
        Verdict.WARNING,
        lambda seen: _some(seen.exposed, seen, shlex.join(seen.exposed)),
        "others than root and the service may read {0}",
        f"make a new one if others use this machine; else: sudo chown root:{SERVICE} {{3}} && sudo chmod 640 {{3}}",
    ),
    Fault(
        "private key",
        Verdict.WARNING,
        lambda seen: _some(seen.authority_keys, seen, shlex.join(seen.authority_keys)),
        "{0} is the authority's key: who takes this robot's card can make certificates for all its robots",
        "see that it is on another machine, then: sudo shred -u {3}",
    ),
)
