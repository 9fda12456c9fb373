"""Starts the process that simulates the body, from within the gateway's. It ends when the gateway does."""

import importlib.util
import json
import os
import secrets
import select
import subprocess
import sys
import threading
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Final, Self

import zenoh

from gateway.errors import ConfigError
from gateway.people.physics.assumed import Assumed
from gateway.people.terminal import hint
from gateway.robot.edge.exposure import connect_endpoints, listen_endpoints
from gateway.robot.spi.servo_page import ServoPage
from gateway.zenoh_config import insert

START_S: Final = 30.0
"""It loads MuJoCo in less than one."""
READY: Final = "ready"
_ANY_ADDRESS: Final = {"/0.0.0.0:": "/127.0.0.1:", "/[::]:": "/[::1]:"}
_RETRY: Final = {"period_init_ms": 100, "period_max_ms": 500, "period_increase_factor": 1.5}


class BodyProcess:
    """The process; it has begun, and waits for `connect`, when the constructor returns."""

    def __init__(self, geometry: Path | None, assumed: Assumed) -> None:
        """Raises ConfigError where MuJoCo is not installed, or cannot simulate this robot."""
        if importlib.util.find_spec("mujoco") is None:
            raise ConfigError("the physics is missing: pip install 'hexapod-gateway[physics]'")
        self.page = ServoPage()
        self.zenoh_id = f"{secrets.randbelow(15) + 1:x}{secrets.token_hex(15)}{secrets.randbelow(15) + 1:x}"
        given = {
            "page": self.page.fd,
            "geometry": None if geometry is None else str(geometry),
            **assumed._asdict(),
            "terrain": str(assumed.terrain),
        }
        its_end, self._lifeline = os.pipe()
        self._words, its_words = os.pipe()
        command = [sys.executable, "-m", "gateway.people.physics", json.dumps(given)]
        self._process = subprocess.Popen(command, stdin=its_end, stdout=its_words, pass_fds=[self.page.fd])
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

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def connect(self, gateway: zenoh.Config) -> None:
        """The gateway of this configuration is ready: have the body published there. Never waits."""
        line = str(_client_config(gateway, self.zenoh_id)).encode() + b"\n"
        with suppress(OSError):  # it has ended, which `_watch` reports
            os.write(self._lifeline, line)

    def close(self) -> None:
        """End it."""
        self._ended = True
        os.close(self._lifeline)
        try:
            self._process.wait(2.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def _wait(self) -> None:
        """Until it simulates, or says why it cannot."""
        readable, _, _ = select.select([self._words], [], [], START_S)
        said = os.read(self._words, 4096).decode().strip() if readable else ""
        os.close(self._words)
        if said != READY:
            raise ConfigError(said or "the physics process did not start; its own words are above")

    def _watch(self) -> None:
        status = self._process.wait()
        if not self._ended:
            how = f"was killed by signal {-status}" if status < 0 else f"ended with exit code {status}"
            hint(f"the physics process {how}: nobody simulates the body any more, and the gateway goes on without")


def _client_config(gateway: zenoh.Config, zenoh_id: str) -> zenoh.Config:
    """A client's, of the gateway itself or of what it dials, with its namespace and certificates."""
    config = zenoh.Config.from_json5(str(gateway))
    endpoints = [_dialled(endpoint) for endpoint in listen_endpoints(gateway)] or connect_endpoints(gateway)
    for key, value in (
        ("mode", "client"),
        ("id", zenoh_id),
        ("listen/endpoints", []),
        ("connect/endpoints", endpoints),
        ("connect/timeout_ms", -1),
        ("connect/retry", _RETRY),
        ("access_control/enabled", False),
        ("transport/link/tls/verify_name_on_connect", False),  # it is on this machine, by another address
    ):
        insert(config, key, value, key)
    return config


def _dialled(endpoint: str) -> str:
    for any_address, here in _ANY_ADDRESS.items():
        endpoint = endpoint.replace(any_address, here)
    return endpoint
