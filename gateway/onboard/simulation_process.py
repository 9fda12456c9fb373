"""Starts a process that simulates a part of the robot, from within the gateway's. It ends when the gateway does."""

import json
import os
import select
import shutil
import subprocess
import sys
import tempfile
import threading
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Final, Self

from gateway.errors import ConfigError
from gateway.people.terminal import hint

START_S: Final = 30.0
"""The slowest loads MuJoCo in less than one."""


class SimulationProcess:
    """The process; it simulates when the constructor returns."""

    name: str
    lost: str
    """What its end means, as a sentence's second half."""

    def __init__(
        self, module: str, given: Mapping[str, object], pages: Sequence[int], folder: Path, begun: str
    ) -> None:
        """Runs `module` with `given` as JSON, and passes it these descriptors. Raises ConfigError with the first line
        that it writes, unless that is `begun`. `folder` is private: the process removes it at its end, which also
        comes when the gateway is killed."""
        self.folder = folder
        its_end, self._lifeline = os.pipe()
        words, its_words = os.pipe()
        command = [sys.executable, "-m", module, json.dumps({**given, "folder": str(folder)})]
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}  # an isolated Python has set its own
        self._process = subprocess.Popen(command, stdin=its_end, stdout=its_words, pass_fds=pages, env=environment)
        os.close(its_end)
        os.close(its_words)
        self._ended = False
        try:
            readable, _, _ = select.select([words], [], [], START_S)
            said = os.read(words, 4096).decode().strip() if readable else ""
            os.close(words)
            if said != begun:
                raise ConfigError(said or f"the {self.name} process did not start; its own words are above")
        except BaseException:
            self.close()
            raise
        threading.Thread(target=self._watch, name=self.name, daemon=True).start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def tell(self, line: str) -> None:
        """Write it this line. Never waits."""
        with suppress(OSError):  # it has ended, which `_watch` reports
            os.write(self._lifeline, line.encode() + b"\n")

    def close(self) -> None:
        """End the process."""
        self._ended = True
        os.close(self._lifeline)
        try:
            self._process.wait(2.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def _watch(self) -> None:
        status = self._process.wait()
        shutil.rmtree(self.folder, ignore_errors=True)  # as it has done itself, unless it was killed
        if not self._ended:
            how = f"was killed by signal {-status}" if status < 0 else f"ended with exit code {status}"
            hint(f"the {self.name} process {how}: {self.lost}")


def private_folder(purpose: str) -> Path:
    """A new one, which only this user may enter."""
    return Path(tempfile.mkdtemp(prefix=f"hexapod-{purpose}-"))
