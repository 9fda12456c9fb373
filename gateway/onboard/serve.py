"""`run`: the service, and what it prints once it is ready."""

from collections.abc import Sequence

import zenoh
from gateway.people.tools.body_process import BodyProcess
from gateway.robot.edge.simulated_body import endpoint

from gateway.people.terminal import say, this_command
from gateway.robot import service
from gateway.robot.settings import Settings
from gateway.robot.spi.unreliable import Faults
from gateway.zenoh_config import DEFAULT_ENDPOINT, listen_endpoints


def run(settings: Settings, *, simulated: bool, body: BodyProcess | None = None, faults: Faults | None = None) -> None:
    """Run the service and, once it is ready, say where it is and what to try next.

    `body`: what the servos of a simulated controller move. `faults`: which of its transfers fail.
    """
    controller = "a simulated controller" if simulated else settings.spi.device
    robot = controller if body is None else "a simulated robot"

    def ready(config: zenoh.Config) -> None:
        if body is not None:
            body.connect(config)
        endpoints = [each for each in listen_endpoints(config) if body is None or each != endpoint(body.folder)]
        where = ", ".join(endpoints) or f"no port of its own ({settings.zenoh.config})"
        say(f"hexapod-gateway is ready: {where} → {robot} ({settings.spi.framing})")
        say(next_step(endpoints, this_command()))

    physics = None if body is None else service.Physics(body.page, body.zenoh_id, body.folder)
    service.run(settings, simulated=simulated, physics=physics, faults=faults, on_ready=ready)


def next_step(endpoints: Sequence[str], command: str) -> str:
    """What to try, where the service listens on `endpoints`; `command` is how this program was called."""
    plain = [endpoint for endpoint in endpoints if not endpoint.startswith(("tls/", "quic/"))]
    if not plain:
        made = "NAME.json5 is made by: hexapod-gateway certs issue NAME --role operator, where ca.key is"
        return f"Try, on a laptop: hexapod-gateway check --zenoh-config NAME.json5 ({made})"
    connect = "" if DEFAULT_ENDPOINT in plain else f" --connect {plain[0]}"
    return f"Try, in a second terminal: {command} walk --forward 0.1 --seconds 5{connect}"
