"""What deploy/install.sh installed: the release's files, the link and command that lead to it, unit and udev rule."""

import os
import re
import shlex
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Final, NamedTuple

from gateway.onboard import whole
from gateway.onboard.check.table import RESTART, SERVICE, CheckedRobot, Probe, Seen, failure, text, warning

_COMMAND: Final = f"/usr/local/bin/{SERVICE}"


class Shipped(NamedTuple):
    """A file that the installer copies out of the release, which has it under `source`. `after` makes it effective."""

    source: str
    place: str
    after: str


SHIPPED: Final = (
    Shipped(f"systemd/{SERVICE}.service", f"/etc/systemd/system/{SERVICE}.service",
            f"sudo systemctl daemon-reload && sudo systemctl enable {SERVICE} && {RESTART}"),
    Shipped(f"udev/60-{SERVICE}.rules", f"/etc/udev/rules.d/60-{SERVICE}.rules",
            "sudo udevadm control --reload; sudo udevadm trigger --subsystem-match=spidev"),
)  # fmt: skip


def names(found: Sequence[str], folder: Path | str, **more: object) -> Seen | None:
    """A few names in one sentence; nothing without any."""
    rest = f" and {len(found) - whole.SHOWN} more" if len(found) > whole.SHOWN else ""
    paths = shlex.join(str(Path(folder, each)) for each in found)
    return Seen(some=", ".join(found[: whole.SHOWN]) + rest, all=paths, **more) if found else None


def _files(robot: CheckedRobot) -> Iterator[Seen | None]:
    """A reading for each kind of fault."""
    release = robot.path(whole.INSTALLED).resolve()
    if release.is_dir():
        again = whole.how_to_repeat(release)
        for kind, found in whole.compare(release)._asdict().items():
            yield names(found, release, kind=kind, release=release, again=again)


def _command(robot: CheckedRobot) -> Seen | None:
    path, link = robot.path(_COMMAND), robot.path(whole.INSTALLED)
    there = os.path.lexists(path)
    other = path.resolve() != (link / "bin" / SERVICE).resolve() or not there
    return Seen(other=other, leads=f"leads to {path.resolve()}" if there else "is missing") if link.is_dir() else None


def _shipped(robot: CheckedRobot) -> Iterator[Seen]:
    """A damaged release is another line."""
    release = robot.path(whole.INSTALLED).resolve()
    deploy = next(release.glob("lib/python*/site-packages/gateway/deploy"), release / "deploy")
    for each in SHIPPED:
        wanted, place = text(deploy / each.source), robot.path(each.place)
        yield Seen(
            place=each.place, source=deploy / each.source, after=each.after,
            differs=bool(wanted) and text(place) != wanted,
            masked=each is SHIPPED[0] and robot.unit.get("LoadState") == "masked",
            how="is not as this release has it" if place.exists() else "is missing",
        )  # fmt: skip


def running_release(process: int, root: Path = Path("/")) -> Path | None:
    """The folder that a process has loaded the gateway from; None where none runs, or this user may not look.

    The kernel reports it: the command line names the link, which may lead elsewhere by now.
    """
    with suppress(OSError):
        found = re.search(rf"{whole.INSTALLED}-[^/ \n]+", (root / f"proc/{process}/maps").read_text())
        return Path(found.group()) if found else None
    return None


def _runs(robot: CheckedRobot) -> Seen | None:
    runs = running_release(int(robot.unit.get("MainPID", 0)))
    return None if runs is None else Seen(runs=runs, installed=whole.INSTALLED.resolve())


# fmt: off
PROBES: Final = (
    Probe("release", _files, (
          failure(lambda r: r.kind == "changed",
                  "not as installed in {release}: {some}. The service, or its Stops after a crash, may fail",
                  "{again}"),
          warning(lambda r: r.kind == "added",
                  "in {release}, and not installed with it: {some}. Python may load it", "sudo rm {all}"),
          failure(lambda r: r.kind == "closed",
                  "in {release}, not for all to read, or not for root alone to write: {some}",
                  f"sudo chown -R root:root {{release}} && sudo chmod -R u+rwX,go+rX,go-w {{release}} && {RESTART}"))),
    Probe("release", _runs, (warning(lambda r: r.runs != r.installed,
          "the service that runs is another release than the one installed: {runs}, not {installed}",
          f"stop the robot, then: sudo systemctl restart {SERVICE}"),)),
    Probe("command", _command, (warning(lambda r: r.other,
          f"{_COMMAND} {{leads}}: commands are another release's than the service",
          f"sudo ln -sfnT {whole.INSTALLED}/bin/{SERVICE} {_COMMAND}"),)),
    Probe("installed file", _shipped, (
          failure(lambda r: r.masked, f"{SERVICE} is masked, or its unit is empty: it cannot start",
                  f"sudo systemctl unmask {SERVICE} && sudo install -m 644 {{source}} {{place}} && {{after}}"),
          failure(lambda r: r.differs, "{place} {how} (changes belong into a drop-in: systemctl edit)",
                  "stop the robot, then: sudo install -D -m 644 {source} {place} && {after}"))),
)
# fmt: on
