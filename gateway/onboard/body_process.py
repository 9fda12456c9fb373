"""Starts the process that simulates the body, from within the gateway's. It ends when the gateway does."""

import importlib.util
import json
import os
import secrets
import select
import shutil
import subprocess
import sys
import tempfile
import threading
from contextlib import suppress
from pathlib import Path
from typing import Final, Self

import zenoh

from gateway.errors import ConfigError
from gateway.host.sensed_page import SensedPage
from gateway.host.servo_page import ServoPage
from gateway.people.physics.assumed import Assumed
from gateway.people.terminal import hint
from gateway.robot.zenoh_io import simulated_body

START_S: Final = 30.0
"""It loads MuJoCo in less than one."""
READY: Final = "ready"


class BodyProcess:
    """The process; it has begun, and waits for `connect`, when the constructor returns."""

    def __init__(self, geometry: Path | None, assumed: Assumed) -> None:
        """Raises ConfigError where MuJoCo is not installed, or cannot simulate this robot."""
        if importlib.util.find_spec("mujoco") is None:
            raise ConfigError("the physics is missing: pip install 'hexapod-gateway[physics]'")
        self.page, self.sensed = ServoPage(), SensedPage()
        self.folder = Path(tempfile.mkdtemp(prefix="hexapod-body-"))
        """Private. The process removes it at its end, which also comes when the gateway is killed."""
        self.zenoh_id = f"{secrets.randbelow(15) + 1:x}{secrets.token_hex(15)}{secrets.randbelow(15) + 1:x}"
        given = {
            "page": self.page.fd,
            "sensed": self.sensed.fd,
            "folder": str(self.folder),
            "geometry": None if geometry is None else str(geometry),
            **assumed._asdict(),
            "terrain": str(assumed.terrain),
        }
        its_end, self._lifeline = os.pipe()
        self._words, its_words = os.pipe()
        command = [sys.executable, "-m", "gateway.people.physics", json.dumps(given)]
        pages = [self.page.fd, self.sensed.fd]
        self._process = subprocess.Popen(command, stdin=its_end, stdout=its_words, pass_fds=pages)
        os.close(its_end)
        os.close(its_words)
        self._ended = False
        try:
            self._wait()
        except BaseException:
            self.close()
            raise
        threading.Thread(target=self._watch, name="physics", daemon=True).start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def connect(self, gateway: zenoh.Config) -> None:
        """The gateway of this configuration is ready: have the body published there. Never waits."""
        line = str(simulated_body.client_config(gateway, self.folder, self.zenoh_id)).encode() + b"\n"
        with suppress(OSError):  # it has ended, which `_watch` reports
            os.write(self._lifeline, line)

    def close(self) -> None:
        """End the process that simulates the body."""
        self._ended = True
        os.close(self._lifeline)
        try:
            self._process.wait(2.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def _wait(self) -> None:
        """Wait until it simulates. Raises ConfigError with its reason where it cannot."""
        readable, _, _ = select.select([self._words], [], [], START_S)
        said = os.read(self._words, 4096).decode().strip() if readable else ""
        os.close(self._words)
        if said != READY:
            raise ConfigError(said or "the physics process did not start; its own words are above")

    def _watch(self) -> None:
        status = self._process.wait()
        shutil.rmtree(self.folder, ignore_errors=True)  # as it has done itself, unless it was killed
        if not self._ended:
            how = f"was killed by signal {-status}" if status < 0 else f"ended with exit code {status}"
            hint(f"the physics process {how}: nobody simulates the body any more, and the gateway goes on without")
