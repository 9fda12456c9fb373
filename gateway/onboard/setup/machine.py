"""The robot's computer, as `setup` changes it. Each change prints a sentence; a dry run only prints."""

import os
import stat
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

from gateway.errors import ConfigError, GatewayError
from gateway.files import durable
from gateway.onboard import release_switch
from gateway.people.terminal import say
from gateway.words.own_command import command

SERVICE: Final = "hexapod-gateway"
ETC: Final = f"/etc/{SERVICE}"
KEPT_CONFIGURATION: Final = f"/run/{SERVICE}/gateway.toml"
"""The service's own copy, written at its start."""
_MOST_BYTES: Final = 1_000_000
_COMMAND_S: Final = 120
"""Longer than the unit's TimeoutStopSec and TimeoutStartSec together."""

Run = Callable[[Sequence[str]], "subprocess.CompletedProcess[str]"]


def _run(words: Sequence[str]) -> "subprocess.CompletedProcess[str]":
    """Run a program. Raises GatewayError if it is missing or hangs."""
    try:
        return subprocess.run(words, capture_output=True, text=True, check=False, timeout=_COMMAND_S)
    except FileNotFoundError:
        raise GatewayError(f"there is no {words[0]}: the service needs a computer that runs systemd") from None
    except subprocess.TimeoutExpired:
        raise GatewayError(f"{' '.join(words)} has not ended after {_COMMAND_S} s; see: systemctl") from None


class Machine:
    """A computer with its files below `root` and its programs started by `run`; tests replace both."""

    def __init__(
        self,
        root: Path = Path("/"),
        run: Run = _run,
        why_not_now: Callable[[], str] = release_switch.why_not_now,
        *,
        dry: bool = False,
        force: bool = False,
    ) -> None:
        self.root = root
        self.run = run
        self.why_not_now = why_not_now
        """Returns why the service may not restart now; "" if it may."""
        self.dry = dry
        self.force = force
        self.reboot_due = False
        self.restart_due = False
        """Whether something that the service reads at its start has changed."""

    def path(self, absolute: str) -> Path:
        """Return this path of the computer."""
        return self.root / absolute.lstrip("/")

    def change(self, sentence: str, act: Callable[[], object]) -> None:
        """Print the sentence, and call `act` unless this is a dry run."""
        say(sentence)
        if not self.dry:
            act()

    def read(self, absolute: str) -> bytes | None:
        """Return a file's content; None if it is missing, or empty as after a power cut. Raises ConfigError."""
        try:
            data = durable.read(self.path(absolute), _MOST_BYTES)
        except PermissionError:
            raise ConfigError(f"only root may read {absolute}: begin the command with sudo") from None
        except ValueError as error:
            raise ConfigError(f"{absolute} {error}") from None
        return data if data is not None and data.strip(b"\0 \t\r\n") else None

    def put(self, absolute: str, data: bytes, sentence: str = "", *, group: str = SERVICE) -> bool:
        """Write a file for root and `group` if it differs, durably and atomically. Return whether it differed."""
        if self.read(absolute) == data:
            return False
        if group == SERVICE:
            self.will_restart()
        self.change(sentence or f"write {absolute}", lambda: self._write(absolute, data, group))
        return True

    def _write(self, absolute: str, data: bytes, group: str) -> None:
        path, gid = self.path(absolute), self.gid(group)
        if not path.parent.is_dir():
            path.parent.mkdir(0o750, parents=True)
            os.chown(path.parent, -1, gid)
            path.parent.chmod(0o750)  # regardless of the umask
        durable.write_with_mode(path, data, 0o640, prepare=lambda descriptor: os.fchown(descriptor, -1, gid))

    def gid(self, group: str) -> int:
        """Return a group's id. Raises ConfigError."""
        for line in self.path("/etc/group").read_text().splitlines():
            name, _, number, *_ = line.split(":")
            if name == group:
                return int(number)
        raise ConfigError(f"there is no group {group}, which the package makes: sudo apt install --reinstall {SERVICE}")

    def let_read(self, absolute: str, group: str) -> bool:
        """Let only root and this group read a folder: `scp` leaves keys as 0600. Return whether a mode changed."""
        folder = self.path(absolute)
        if not folder.is_dir():
            return False
        gid, owned = self.gid(group), (path for path in (folder, *folder.rglob("*")) if not path.is_symlink())
        wrong = [path for path in owned if has_wrong_rights(path, os.geteuid(), gid)]

        def give() -> None:
            for path in wrong:
                os.chown(path, os.geteuid(), gid)
                path.chmod(0o750 if path.is_dir() else 0o640)

        if wrong:
            self.change(f"let {group} read all of {absolute}, and nobody else (root:{group})", give)
        return bool(wrong)

    def check(self) -> int:
        """Run `check` as a process, since --back changes the release. Return its exit code."""
        installed = self.path(f"/usr/bin/{SERVICE}")
        own = [str(installed)] if installed.exists() else [sys.executable, "-m", "gateway"]
        return subprocess.run([*own, "check"], check=False).returncode

    # ---- systemd

    def systemctl(self, *words: str, check: bool = True) -> str:
        """Run systemctl and return its output. Raises GatewayError with its first line of error."""
        done = self.run(["systemctl", *words])
        if check and done.returncode:
            why = (done.stderr.strip() or f"exit code {done.returncode}").splitlines()[0]
            raise GatewayError(f"systemctl {' '.join(words)} failed: {why}")
        return done.stdout.strip()

    def show(self, unit: str, name: str) -> str:
        """Return one property of a unit."""
        return self.systemctl("show", f"--property={name}", "--value", unit, check=False)

    def is_active(self, unit: str) -> bool:
        """Return whether a unit runs. A unit whose starts fail again and again does not."""
        return self.show(unit, "ActiveState") in ("active", "reloading")

    def enable(self, *units: str) -> None:
        """Let units start with the machine."""
        if missing := [unit for unit in units if self.show(unit, "UnitFileState") != "enabled"]:
            sentence = f"enable {' and '.join(missing)}: starts with the machine"
            self.change(sentence, lambda: self.systemctl("enable", "--quiet", *missing))

    def will_restart(self) -> None:
        """Call before each change of what the service reads. Raises GatewayError while a servo runs."""
        if not self.restart_due:
            self.check_no_servo_runs()
        self.restart_due = True

    def check_no_servo_runs(self) -> None:
        """Raise GatewayError if a servo runs, or the service does not report whether one runs."""
        if not (self.dry or self.force) and (reason := self.why_not_now()):
            fix = f"stop the robot ({command('stop')}) and run setup again, or add --force"
            raise GatewayError(f"{reason}, and a restart would stop it: {fix}")


def has_wrong_rights(path: Path, uid: int, gid: int) -> bool:
    """Return whether others than this user and group may read a file or folder, or the group may not."""
    status = path.stat()
    mode, needed = stat.S_IMODE(status.st_mode), 0o050 if path.is_dir() else 0o040
    return status.st_gid != gid or status.st_uid != uid or bool(mode & 0o027) or mode & needed != needed
