"""A gateway on the simulated controller with the certificates that `certs` makes."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import zenoh

from gateway import certs
from gateway.client import Client
from gateway.zenoh.config import load_config
from tests.hil.bed import SpiTestbed
from tests.support.gateway_process import Gateway, free_port
from tests.support.waiting import Closing

HOST = "127.0.0.1"


class Secured(Closing):
    """The gateway, an operator (anna) and an observer (otto)."""

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
