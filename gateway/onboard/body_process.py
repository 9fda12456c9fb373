"""Starts the process that simulates the body, from within the gateway's."""

import importlib.util
import secrets
from pathlib import Path
from typing import Final

import zenoh

from gateway.errors import ConfigError
from gateway.host.shared_page import SensedPage, ServoPage
from gateway.onboard.simulation_process import SimulationProcess, private_folder
from gateway.people.physics.assumed import Assumed
from gateway.simulation import body as simulated_body

READY: Final = "ready"


class BodyProcess(SimulationProcess):
    """The process; it has begun, and waits for `connect`, when the constructor returns."""

    name = "physics"
    lost = "nobody simulates the body any more, and the gateway goes on without"

    def __init__(self, geometry: Path | None, assumed: Assumed) -> None:
        """Raises ConfigError where MuJoCo is not installed, or cannot simulate this robot."""
        if importlib.util.find_spec("mujoco") is None:
            raise ConfigError("the physics is missing: pip install 'hexapod-gateway[physics]'")
        self.page, self.sensed = ServoPage(), SensedPage()
        self.zenoh_id = f"{secrets.randbelow(15) + 1:x}{secrets.token_hex(15)}{secrets.randbelow(15) + 1:x}"
        given = {
            "page": self.page.fd,
            "sensed": self.sensed.fd,
            "geometry": None if geometry is None else str(geometry),
            **assumed._asdict(),
            "terrain": str(assumed.terrain),
        }
        pages = (self.page.fd, self.sensed.fd)
        super().__init__("gateway.people.physics", given, pages, private_folder("body"), READY)

    def connect(self, gateway: zenoh.Config) -> None:
        """The gateway of this configuration is ready: have the body published there. Never waits."""
        self.tell(str(simulated_body.client_config(gateway, self.folder, self.zenoh_id)))
