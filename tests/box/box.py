"""A real systemd in a box (see `systemd-box`), which commands are sent into from a test outside.

    with Box(folder) as box:
        box.run("systemctl", "start", "hexapod-gateway")
        box.run("journalctl", "-u", "hexapod-gateway").stdout

`box.shared` is a folder that both sides see; inside, it is `/box-out`.
"""

import os
import select
import shutil
import subprocess
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path

from tests.hil.bed import missing_packages
from tests.support.child import Child
from tests.support.waiting import Closing

PROGRAM = Path(__file__).with_name("systemd-box")
SHARED_INSIDE = Path("/box-out")
BOOT_S = 30.0  # it takes about one
LIFE_S = 1800  # after which a forgotten box ends by itself
PATH_INSIDE = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"

# Says that the system is up, then holds the box open until the other end of the second pipe is closed.
SCRIPT = """#!/bin/bash
echo up >/box-out/up
read -r _ </box-out/end
exit 0
"""


@cache
def lacks() -> str:
    """Return what this machine lacks for a box, in one line; empty when nothing."""
    if lack := lacks_tools("a systemd in a box is", "unshare", "nsenter", "systemctl", "ip"):
        return lack
    if not Path("/lib/systemd/systemd").exists():
        return "a systemd in a box needs Debian's systemd"
    probe = ["unshare", "--fork", "--pid", "--mount", "--uts", "--ipc", "--net", "--cgroup", "mount", "-t", "cgroup2"]
    namespaces = subprocess.run([*probe, "none", "/mnt"], capture_output=True, text=True, check=False)
    if namespaces.returncode:
        return f"a systemd in a box needs namespaces: {namespaces.stderr.strip()}"
    return missing_packages()


def lacks_tools(what: str, *tools: str) -> str:
    """Return what this machine lacks for that, which these tools and root do, in one line; empty when nothing."""
    missing = [tool for tool in tools if shutil.which(tool) is None]
    if os.geteuid() != 0 or missing:
        return f"{what} not run here: that needs root, and {', '.join(missing) or 'no more'}"
    return ""


class Box(Closing):
    """A booted box; its end is the end of everything in it."""

    def __init__(
        self,
        folder: Path,
        *,
        disk: Path | None = None,
        base: Path | None = None,
        keep: Path | None = None,
        root: Path | None = None,
        life_s: int = LIFE_S,
    ) -> None:
        """Boot it. `folder` gets the script and the shared folder; `disk`, an ext4 image, what is written inside.

        `root`: the folder of another system, in place of this machine's. `keep` becomes an archive of what is written
        inside at the end; a box with it as its `base` begins there.
        """
        self.shared = folder / "shared"
        self.shared.mkdir()
        self.shared.chmod(0o755)  # pytest's folders are for their owner only, and services have users of their own
        script = folder / "script"
        script.write_text(SCRIPT)
        for name in ("up", "end"):
            os.mkfifo(self.shared / name)
        up = os.open(self.shared / "up", os.O_RDONLY | os.O_NONBLOCK)
        places = {"BOX_OUT": self.shared, "BOX_DISK": disk, "BOX_BASE": base, "BOX_KEEP": keep, "BOX_ROOT": root}
        given = {name: str(place) for name, place in places.items() if place is not None}
        self._system = Child([str(PROGRAM), str(script), str(life_s)], {**os.environ, **given})
        try:
            if not select.select([up], [], [], BOOT_S)[0]:
                raise TimeoutError(f"the box did not boot within {BOOT_S} s: {self._system}")
        except TimeoutError:
            self._system.close()
            raise
        finally:
            os.close(up)
        self._end = os.open(self.shared / "end", os.O_WRONLY)
        self._pid = (self.shared / ".pid").read_text().strip()

    def close(self) -> None:
        os.close(self._end)
        try:
            self._system.wait(20)
        finally:
            self._system.close()

    @property
    def root(self) -> Path:
        """Return the path of its root directory outside the box."""
        return Path(f"/proc/{self._pid}/root")

    def command(self, *command: str) -> list[str]:
        """Return the command line that runs `command` inside, from outside. Let it end by itself.

        Killed, it takes `command` with it, but leaves it to this machine's init to be buried, and until then the
        box cannot end: some inits take ten seconds.
        """
        enter = ["nsenter", f"--target={self._pid}", "--all", "--root", "--wd", "--"]
        return [*enter, "setpriv", "--pdeathsig=KILL", "--", *command]

    def run(
        self, *command: str, env: Mapping[str, str] | None = None, check: bool = True, timeout_s: float = 30
    ) -> subprocess.CompletedProcess[str]:
        """Run a command inside, as root, and wait for its end; `check`: it must succeed."""
        done = subprocess.run(
            self.command(*command),
            env={"PATH": PATH_INSIDE, "HOME": "/root", "LANG": "C.UTF-8", **(env or {})},
            capture_output=True,
            text=True,
            timeout=timeout_s,
            check=False,
        )
        assert not check or done.returncode == 0, f"{' '.join(command)}: {done.returncode}\n{done.stdout}{done.stderr}"
        return done

    def write(self, path: str, text: str) -> None:
        subprocess.run(
            self.command("/bin/sh", "-c", 'mkdir -p "$(dirname "$1")" && cat >"$1"', "sh", path),
            input=text,
            text=True,
            check=True,
            timeout=10,
        )

    def read(self, path: str) -> str:
        return self.run("cat", path).stdout

    def exists(self, path: str) -> bool:
        return self.run("test", "-e", path, check=False).returncode == 0


class Unit:
    """A service inside."""

    def __init__(self, box: Box, name: str) -> None:
        self.box = box
        self.name = name

    def systemctl(self, verb: str, *options: str, check: bool = True) -> subprocess.CompletedProcess[str]:
        return self.box.run("systemctl", verb, *options, self.name, check=check)

    def properties(self, *names: str) -> Sequence[str]:
        """Return these of its properties, as `systemctl show` gives them."""
        shown = self.systemctl("show", *(f"--property={name}" for name in names)).stdout
        values = dict(line.split("=", 1) for line in shown.splitlines())
        return [values[name] for name in names]

    def property(self, name: str) -> str:
        return self.properties(name)[0]
