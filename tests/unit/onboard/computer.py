"""A robot's computer as a folder, for `setup`, with systemd as an object: its units are properties in a dictionary."""

import contextlib
import io
import os
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from gateway.onboard.setup import Wanted, setup
from gateway.onboard.setup.machine import Machine

TOML = "/etc/hexapod-gateway/gateway.toml"
TEMPLATE = Path(__file__).parents[3] / "deploy/gateway.toml"
CONFIG_TXT = "/boot/firmware/config.txt"


class Systemd:
    """Starts what it is asked to, unless `is_broken`; `calls` are the changes that it was asked for."""

    def __init__(self) -> None:
        self.units: dict[str, dict[str, str]] = {}
        self.calls: list[str] = []
        self.is_broken: Callable[[], bool] = lambda: False
        self.journal = ""

    def unit(self, name: str, **properties: str) -> None:
        self.units.setdefault(name, {}).update(properties)

    def __call__(self, command: Sequence[str]) -> "subprocess.CompletedProcess[str]":
        if command[0] == "journalctl":
            return subprocess.CompletedProcess(command, 0, self.journal, "")
        _, verb, *words = command
        names = [each for each in words if not each.startswith("--")]
        if verb == "show":
            name = words[0].removeprefix("--property=")
            return subprocess.CompletedProcess(command, 0, self.units.get(names[0], {}).get(name, ""), "")
        self.calls.append(" ".join([verb, *words]))
        if verb == "restart" and self.is_broken():
            return subprocess.CompletedProcess(command, 1, "", "Job failed")
        changed = {"enable": {"UnitFileState": "enabled"}, "restart": {"ActiveState": "active"}}.get(verb, {})
        for each in names:
            self.unit(each, **changed)
        return subprocess.CompletedProcess(command, 0, "", "")


class _Checked(Machine):
    """`check` is another program, of which only the call counts here."""

    def check(self) -> int:
        print("(check)")
        return 0


class Computer:
    """The folder, with the package installed and nothing set up."""

    def __init__(self, root: Path) -> None:
        self.root, self.systemd, self.busy = root, Systemd(), ""
        gid = os.getgid()
        self.write("/etc/group", f"root:x:0:\nhexapod-gateway:x:{gid}:\nhexapod-console:x:{gid}:\n")
        self.write("/usr/share/hexapod-gateway/gateway.toml", TEMPLATE.read_text())
        self.write(TOML, TEMPLATE.read_text(), 0o640)
        (root / "etc/hexapod-gateway").chmod(0o750)

    def write(self, path: str, text: str, mode: int = 0o644) -> Path:
        file = self.root / path.lstrip("/")
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
        file.chmod(mode)
        return file

    def read(self, path: str) -> str:
        return (self.root / path.lstrip("/")).read_text()

    def files(self) -> dict[str, bytes]:
        """Everything below the folder."""
        return {str(each.relative_to(self.root)): each.read_bytes() for each in self.root.rglob("*") if each.is_file()}

    def says(self, *, dry: bool = False, force: bool = False, **wanted: Any) -> list[str]:
        """The lines that `setup` prints, which ends with 0."""
        machine = _Checked(self.root, self.systemd, lambda: self.busy, dry=dry, force=force)
        with contextlib.redirect_stdout(io.StringIO()) as stdout:
            assert setup(machine, Wanted(**wanted)) == 0
        return stdout.getvalue().splitlines()
