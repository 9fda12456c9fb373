"""Switches between the installed releases, by the link `current` in their folder.

The package's postinst calls `take` once dpkg has unpacked a release. The previous release is kept as hard links that
dpkg does not know. The units are copied from the release, so that they are never newer than the code they start.
"""

import os
import pwd
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from threading import Timer
from typing import Final

from gateway.errors import ConfigError, GatewayError
from gateway.files import durable
from gateway.host.directories import CONFIGURATION, SERVICE_RUNTIME
from gateway.host.settings_table import WireSettings

LIBRARY: Final = Path("/usr/lib/hexapod-gateway")
UNITS: Final = Path("/usr/lib/systemd/system")
_FORMER: Final = Path("/opt/hexapod-gateway")
"""The folder of the installer before the package, whose unit and command hide the package's until `setup` ran."""
_SERVICE: Final = "hexapod-gateway"
_CONSOLE: Final = "hexapod-console"
_SERVOS: Final = SERVICE_RUNTIME / "servos"
"""Written by gateway.robot.service."""
_KEPT: Final = ".kept"
"""Suffix of a release that dpkg does not know (deploy/debian/keep.sh)."""
_WORDS: Final = 3
"""The most lines of a failed trial that are printed."""
_FRESH_NS: Final = 1_000_000_000
_LOOKS: Final = 20
_POLL_S: Final = 0.1
_TRIAL_S: Final = 30.0
"""The same as systemd's limit for the start of the service."""
_TAKE: Final = "sudo dpkg-reconfigure hexapod-gateway"
CONFIGURE: Final = "sudo dpkg --configure -a"
"""Repeats a postinst that failed; until then dpkg-reconfigure rejects the package."""
_BACK: Final = "sudo hexapod-gateway setup --back"
WHY: Final = LIBRARY / "failed"
"""What the last failed `take` printed, for `check`; missing after a successful one."""


def main() -> int:
    """Take the release that contains this module. Return the exit code for postinst."""
    try:
        said, code = take(Path(__file__).resolve().parents[2]), 0
        WHY.unlink(missing_ok=True)
    except (GatewayError, OSError) as error:
        said, code = _failed(error), getattr(error, "exit_code", 1)
    if said:
        sys.stderr.write(f"hexapod-gateway: {said}\n")
    return code


def _failed(error: Exception) -> str:
    """Return what to print of a failed `take`, and keep it for `check`. The release before is whole, and goes on."""
    said = f"{error.filename2 or error.filename}: {error.strerror}" if isinstance(error, OSError) else str(error)
    why = said.splitlines() or [""]
    with suppress(OSError):
        WHY.write_text(why[0])
    goes_on = "the release before this one goes on" if _current() else "no release runs"
    return "\n".join((*why, f"So {goes_on}, and each apt command repeats this. Fix it, then: {CONFIGURE}"))


def take(release: Path) -> str:
    """Run `release` from now on, after a trial. Return what to do next, if anything.

    Raises GatewayError or OSError if this release does not start or fit; the previous one then runs on.
    """
    if _FORMER.exists() or not _is_set_up():
        before = _current()
        _turn(release)
        _remove_others(release, before)
        return f"Next: sudo {'/usr/bin/' if _FORMER.exists() else ''}hexapod-gateway setup"
    _try(release)
    if reason := why_not_now():
        return f"{reason}, so the service goes on with the release before this one. {_how_to_go_on(reason, _TAKE)}"
    return _switch(release)


def other() -> tuple[str, Path]:
    """Return the version that is current, and the release for `setup --back`: a kept one, else the package's.

    Raises ConfigError if there is none.
    """
    current = _current()
    name = "none" if current is None else _version(current)
    found = [path for path in LIBRARY.iterdir() if not path.is_symlink() and (path / "hexapod-gateway").exists()]
    others = sorted((path for path in found if _version(path) != name), key=lambda path: path.suffix != _KEPT)
    if not others:
        fix = "sudo apt install ./hexapod-gateway_VERSION_ARCH.deb"
        raise ConfigError(f"no release other than {name} is kept here; to install one: {fix}")
    return name, others[0]


def go_back(release: Path) -> str:
    """Run the `other` release; a second call returns to the newer one. Return what to do next, if anything.

    Raises ConfigError if a servo may run, and GatewayError if the release does not start.
    """
    _try(release)
    if reason := why_not_now():
        raise ConfigError(f"{reason}. {_how_to_go_on(reason, _BACK)}")
    return _switch(release)


def why_not_now() -> str:
    """Return why the service must not restart now: a servo runs, or may run; "" if it may. Waits up to 2 s."""
    process = _properties()["MainPID"]
    if process == "0":
        return ""
    maps = Path(f"/proc/{process}/maps").read_text(errors="replace")
    if not any(line.endswith(f" {_SERVOS}") for line in maps.splitlines()):
        return _UNKNOWN
    for _ in range(_LOOKS):
        try:
            written_ns, running = map(int, _SERVOS.read_text().split())
        except (OSError, ValueError):
            return _UNKNOWN
        if time.monotonic_ns() - written_ns < _FRESH_NS:
            return _RUNS if running else ""
        time.sleep(_POLL_S)
    return _UNKNOWN


_RUNS: Final = "a servo runs"
_UNKNOWN: Final = "the service does not report whether a servo runs"


def _how_to_go_on(reason: str, command: str) -> str:
    if reason == _RUNS:
        return f"Stop the robot, then: {command}"
    service = f"sudo systemctl stop {_SERVICE} && {command} && sudo systemctl start {_SERVICE}"
    return f"See that no servo runs, then: {service}"


def _is_set_up() -> bool:
    """Return whether the configuration states a wire, or the service is enabled without one."""
    try:
        stated = tomllib.loads(CONFIGURATION.read_text())
        other = "name" in (wire := stated.get("wire", {})) and not WireSettings(wire["name"]).framed
        framing = stated.get("spi", {}).get("framing")
    except (ValueError, AttributeError):  # the trial names the fault
        return True
    return bool(framing) or other or _is_enabled()


def _try(release: Path) -> None:
    """Start `release` with a simulated controller, this robot's configuration and the rights of the service's user."""
    user = pwd.getpwnam(_SERVICE)
    with tempfile.TemporaryDirectory() as folder:
        os.chown(folder, user.pw_uid, user.pw_gid)
        own = {"ZENOH__LISTEN": f'["unixsock-stream/{folder}/trial"]', "ZENOH__CONFIG": ""}
        own |= {"TELEMETRY__METRICS": "", "STATE__PATH": ""}
        environment = {"PATH": "/usr/bin:/bin"} | {f"HEXAPOD_{name}": value for name, value in own.items()}
        command = [str(release / "hexapod-gateway"), "run", "--sim", "--config", str(CONFIGURATION)]
        with (
            tempfile.TemporaryFile("w+") as words,
            subprocess.Popen(
                command,
                env=environment,
                cwd="/",
                user=user.pw_uid,
                group=user.pw_gid,
                extra_groups=[],
                stdout=subprocess.PIPE,
                stderr=words,
                text=True,
            ) as trial,
        ):
            end = Timer(_TRIAL_S, trial.kill)
            end.start()
            is_ready = trial.stdout is not None and "is ready" in trial.stdout.readline()
            trial.terminate()
            is_ready = trial.wait() == 0 and is_ready
            end.cancel()
            words.seek(0)
            why = [line.removeprefix("hexapod-gateway: ") for line in words if line.strip()]
    if not is_ready:
        said = "".join(why[-_WORDS:]).strip() or f"its trial with {CONFIGURATION} printed nothing"
        raise GatewayError(f"{_version(release)} does not start: {said}")


def _switch(release: Path) -> str:
    before, state = _current(), _properties()
    removed = before is None or not (UNITS / f"{_SERVICE}.service").exists()  # also by a removal that was cut off
    _turn(release)
    ran = state["ActiveState"] in {"active", "reloading"}
    stopped = state["ActiveState"] == "inactive" and not removed
    if ran or (_is_enabled() and not stopped):
        if _systemctl("restart", _SERVICE) != 0:
            if not ran or before is None or before == release:
                return f"{_version(release)} is installed, and does not run: journalctl -u {_SERVICE}"
            _turn(before)
            _systemctl("reset-failed", _SERVICE)
            runs = "runs again" if _systemctl("restart", _SERVICE) == 0 else "does not run either"
            raise GatewayError(
                f"{_version(release)} does not run: journalctl -u {_SERVICE} shows why. {_version(before)} {runs}"
            )
        _systemctl("try-restart", _CONSOLE)
    _remove_others(release, before)
    return f"The service is stopped, as before. To start it: sudo systemctl start {_SERVICE}" if stopped else ""


def _turn(release: Path) -> None:
    """Point the link at `release`, and copy its units. At every instant the link and each unit are complete.

    All that needs room on the disk comes before the first change. Raises OSError.
    """
    staged = list[Path]()
    try:
        for unit in (release / "units").iterdir():
            staged.append(UNITS / f"{unit.name}.new")
            shutil.copy(unit, staged[-1])
            durable.sync(staged[-1])
        new = LIBRARY / "current.new"
        new.unlink(missing_ok=True)
        new.symlink_to(release.name)
    except OSError:
        for each in staged:
            each.unlink(missing_ok=True)
        raise
    new.rename(LIBRARY / "current")
    for each in staged:
        each.rename(each.with_suffix(""))
    os.sync()
    _systemctl("daemon-reload")


def _current() -> Path | None:
    current = LIBRARY / "current"
    return current.resolve() if current.exists() else None


def _version(release: Path) -> str:
    return release.name.removesuffix(_KEPT)


def _remove_others(release: Path, before: Path | None) -> None:
    """Remove what neither runs nor is the way back: `before`, or, if that is the same version, what was kept for it."""
    back = before if before is not None and _version(before) != _version(release) else None
    for path in LIBRARY.iterdir():
        if path.is_symlink() or not path.is_dir() or path in (release, back):
            continue
        outdated = path.suffix == _KEPT and (back is not None or _version(path) == _version(release))
        if outdated or not (path / "hexapod-gateway").exists():
            shutil.rmtree(path)


def _is_enabled() -> bool:
    command = ["systemctl", "is-enabled", _SERVICE]
    return _has_systemd() and subprocess.run(command, capture_output=True, check=False).returncode == 0


def _properties() -> Mapping[str, str]:
    """MainPID and ActiveState of the service; without systemd, those of a service that does not run."""
    shown = {"MainPID": "0", "ActiveState": "inactive"}
    if not _has_systemd():
        return shown
    command = ["systemctl", "show", *(f"--property={name}" for name in shown), _SERVICE]
    lines = subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()
    return dict(line.split("=", 1) for line in lines)


def _systemctl(*arguments: str) -> int:
    return subprocess.run(["systemctl", *arguments], check=False).returncode if _has_systemd() else 1


def _has_systemd() -> bool:
    return Path("/run/systemd/system").is_dir()
