"""The gateway as a user starts it: a process of its own, with a configuration file, on a port that nobody else has."""

import itertools
import json
import os
import secrets
import socket
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

import zenoh

from gateway import certs
from gateway.client import Client
from gateway.zenoh.config import load_config
from tests.hil.bed import SpiTestbed
from tests.support.child import Child
from tests.support.command import Ended, run_here
from tests.support.waiting import Closing

READY = "hexapod-gateway is ready"
COMMAND = (sys.executable, "-m", "gateway")

_PORTS: Final = range(10_000, 32_000)
"""Below those that the kernel gives to connections: one of these could be in use before the gateway listens."""
_WORKERS: Final = 8


def _shuffled() -> list[int]:
    """Return free ports: each worker of `pytest -n` has its own, and none comes twice before all others."""
    share = len(_PORTS) // _WORKERS
    worker = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw")) % _WORKERS
    ports = list(_PORTS[worker * share : (worker + 1) * share])
    secrets.SystemRandom().shuffle(ports)
    return ports


_ports = itertools.cycle(_shuffled())


def free_port() -> int:
    """Return a TCP port of this machine's loopback that nobody listens on now."""
    while True:
        with socket.socket() as probe, suppress(OSError):
            port = next(_ports)
            probe.bind(("127.0.0.1", port))
            return port


def dialling(folder: Path, endpoint: str, **more: Any) -> str:
    """Return a Zenoh file of a gateway that dials this."""
    path = folder / "dialling.json5"
    path.write_text(json.dumps({"connect": {"endpoints": [endpoint]}, **more}))
    return str(path)


def write_settings(path: Path, settings: Mapping[str, Mapping[str, Any]]) -> Path:
    """Write a TOML file with these sections, and make the state directory that they name.

    Of a missing one the gateway cannot tell what an earlier run has left, and starts estopped.
    """
    state = settings.get("state", {}).get("path")
    if state:
        Path(state).mkdir(parents=True, exist_ok=True)
    lines = []
    for section, values in settings.items():
        lines.append(f"[{section}]")
        lines += [f"{name} = {json.dumps(value)}" for name, value in values.items()]
    path.write_text("\n".join(lines) + "\n")
    return path


class Gateway(Closing):
    """A running gateway: on the simulated controller, or with `bed` on the emulated kernel device.

    `settings` are its sections, `{"watchdog": {"timeout_ms": 100}}`; without a `zenoh.listen` among them, a free port
    is taken; with `bed` and without `spi.framing`, plain. Unless they state other limits, a busy machine makes
    no command too old and ends no lease. It is ready when the constructor returns.
    """

    def __init__(
        self,
        folder: Path,
        settings: Mapping[str, Mapping[str, Any]] | None = None,
        *,
        bed: SpiTestbed | None = None,
        env: Mapping[str, str] | None = None,
        prefix: Sequence[str] = (),
        program: Sequence[str] = COMMAND,
        options: Sequence[str] = ("--sim",),
        wait: bool = True,
    ) -> None:
        """Start it. `prefix` goes before the command (`ip netns exec …`); `options` behind it, without a `bed`."""
        sections = {name: dict(values) for name, values in (settings or {}).items()}
        sections.setdefault("limits", {}).setdefault("max_age_ms", 10_000)
        sections.setdefault("lease", {}).setdefault("ttl_ms", 5000)
        zenoh = sections.setdefault("zenoh", {})
        zenoh.setdefault("listen", [f"tcp/127.0.0.1:{free_port()}"])
        if bed is not None:
            sections.setdefault("spi", {}).setdefault("framing", "plain")
        self.endpoint: str = zenoh["listen"][0]
        self.config = write_settings(folder / f"gateway-{self.endpoint.rpartition(':')[2]}.toml", sections)
        command = [*prefix, *program, "run", "--config", str(self.config)]
        if bed is not None:
            self.child = bed.spawn(command, env=env)
        else:
            self.child = Child([*command, *options], {**os.environ, **(env or {})})
        if wait:
            self.child.wait_for_output(READY)

    def close(self) -> None:
        self.child.close()

    def client(self, *, source: str | None = "test") -> Client:
        return Client(self.endpoint, source=source, timeout_s=20)

    def run(self, *arguments: str, timeout_s: float = 60) -> Ended:
        """Run one of our commands against it, in this process, until its end: `run("send", "leg", "3", "stop")`."""
        return run_here(*arguments, "--connect", self.endpoint, timeout_s=timeout_s)

    def begin(self, *arguments: str) -> Child:
        """Begin one of our commands against it, as a process of its own."""
        return Child([*COMMAND, *arguments, "--connect", self.endpoint], os.environ)


HOST = "127.0.0.1"


class Secured(Closing):
    """A gateway with the certificates that `certs` makes, an operator (anna) and an observer (otto)."""

    def __init__(
        self,
        folder: Path,
        settings: Mapping[str, Mapping[str, Any]] | None = None,
        *,
        address: str = HOST,
        bed: SpiTestbed | None = None,
        prefix: Sequence[str] = (),
    ) -> None:
        """Start one that listens on `address`."""
        self.folder = folder / "D"
        self.port = free_port()
        certs.folder.init(self.folder, [HOST], port=self.port)
        certs.folder.issue(self.folder, "anna", "operator")
        certs.folder.issue(self.folder, "otto", "observer")
        listen = {"config": str(self.folder / "gateway.json5"), "listen": [f"tls/{address}:{self.port}"]}
        self.gateway = Gateway(folder, {"zenoh": listen, **(settings or {})}, bed=bed, prefix=prefix)

    def close(self) -> None:
        self.gateway.child.close()

    def client(self, name: str) -> Client:
        return Client(None, zenoh_config=self.folder / f"{name}.json5", source=name, timeout_s=20)

    def raw(self, name: str, **overrides: Any) -> zenoh.Config:
        """Return a laptop's own configuration, with its paths resolved, and changed as a stranger might."""
        made = load_config(self.folder / f"{name}.json5")
        for key, value in overrides.items():
            made.insert_json5(key, json.dumps(value))
        return made

    def session(self, name: str, **overrides: Any) -> zenoh.Session:
        return zenoh.open(self.raw(name, **overrides))
