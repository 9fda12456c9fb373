"""Starts the process that simulates the robot's body or its power board. The process ends with the gateway's."""

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
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Final, Self

import zenoh

from gateway.errors import ConfigError
from gateway.host.shared_page import SensedPage, ServoPage
from gateway.people.physics.assumed import Assumed
from gateway.people.terminal import hint
from gateway.robot.host.systemd import VARIABLES
from gateway.simulation import body as simulated_body
from gateway.words.own_command import install

START_S: Final = 30.0
"""The slowest machine loads MuJoCo in less than 1 s."""


class SimulationProcess:
    """A simulating process. It has started when the constructor returns."""

    name: str
    lost: str
    """The consequence of its unexpected end, as the second half of a sentence."""

    def __init__(
        self, module: str, folder: Path, begun: str, page: ServoPage, sensed: SensedPage | None, **options: object
    ) -> None:
        """Run `module`, and pass it the pages' descriptors, and `options` as JSON.

        Raises ConfigError with the first line that the process writes, unless it is `begun`. The process removes the
        private `folder` at its end, also if the gateway is killed.
        """
        self.folder, self.page, self.sensed = folder, page, sensed
        pages = {"page": page.fd} if sensed is None else {"page": page.fd, "sensed": sensed.fd}
        its_end, self._lifeline = os.pipe()
        words, its_words = os.pipe()
        command = [sys.executable, "-m", module, json.dumps({**options, **pages, "folder": str(folder)})]
        environment = {name: value for name, value in os.environ.items() if name not in VARIABLES}
        environment["PYTHONPATH"] = os.pathsep.join(sys.path)  # an isolated Python has set its own
        self._process = subprocess.Popen(
            command, stdin=its_end, stdout=its_words, pass_fds=tuple(pages.values()), env=environment
        )
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

    def close(self) -> None:
        """End the process; after 2 s kill it."""
        self._ended = True
        os.close(self._lifeline)
        try:
            self._process.wait(2.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def _watch(self) -> None:
        status = self._process.wait()
        shutil.rmtree(self.folder, ignore_errors=True)  # a killed process leaves it
        if not self._ended:
            how = f"was killed by signal {-status}" if status < 0 else f"ended with exit code {status}"
            hint(f"the {self.name} process {how}: {self.lost}")


def private_folder(purpose: str) -> Path:
    """Make and return a temporary folder that only this user may enter."""
    return Path(tempfile.mkdtemp(prefix=f"hexapod-{purpose}-"))


class BoardProcess(SimulationProcess):
    """A simulated power board. When the constructor returns, it answers on `channel`, with all outputs off."""

    name = "power board's"
    lost = "nobody simulates the power board any more, so it does not answer"

    def __init__(self, outputs: Sequence[int], page: ServoPage | None, sensed: SensedPage | None) -> None:
        """`outputs`: the servo id on each output. `page`: the simulated controller's targets; None: a new page.
        `sensed`: a simulated body's torques, for the currents."""
        folder, page = private_folder("power"), ServoPage() if page is None else page
        self.channel = str(folder / "can")
        """The serial device for python-can's `slcan`."""
        outputs = list(outputs)
        super().__init__("gateway.simulation.board_port", folder, self.channel, page, sensed, outputs=outputs)


READY: Final = "ready"


class BodyProcess(SimulationProcess):
    """A simulated body. When the constructor returns, it waits for `connect`."""

    name = "physics"
    lost = "nobody simulates the body any more, and the gateway goes on without"

    def __init__(self, geometry: Path | None, assumed: Assumed) -> None:
        """Raises ConfigError if MuJoCo is not installed, or cannot simulate this robot."""
        if importlib.util.find_spec("mujoco") is None:
            raise ConfigError(f"the physics is missing: {install('physics')}")
        self.zenoh_id = f"{secrets.randbelow(15) + 1:x}{secrets.token_hex(15)}{secrets.randbelow(15) + 1:x}"
        options = {
            "geometry": None if geometry is None else str(geometry),
            **assumed._asdict(),
            "terrain": str(assumed.terrain),
        }
        module, folder = "gateway.people.physics.process", private_folder("body")
        super().__init__(module, folder, READY, ServoPage(), SensedPage(), **options)

    def connect(self, gateway: zenoh.Config) -> None:
        """Let the body be published through the gateway with this configuration, once that is ready. Never waits."""
        config = simulated_body.client_config(gateway, self.folder, self.zenoh_id)
        with suppress(OSError):  # the process has ended; `_watch` reports this
            os.write(self._lifeline, f"{config}\n".encode())
