"""`run`: the service, and what it prints once it is ready."""

from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

import zenoh

from gateway.onboard.board_process import BoardProcess
from gateway.onboard.body_process import BodyProcess
from gateway.people.physics.assumed import Assumed
from gateway.people.terminal import say, this_command
from gateway.robot import service
from gateway.robot import settings as settings_file
from gateway.robot.sections import SIMULATED
from gateway.robot.settings import Settings
from gateway.robot.spi import unreliable
from gateway.robot.spi.unreliable import Faults
from gateway.robot.zenoh_io.simulated_body import endpoint
from gateway.zenoh_config import DEFAULT_ENDPOINT, listen_endpoints


def serve(
    config: Path | None, *, simulated: bool, fault: str | None = None, body: tuple[Path | None, Assumed] | None = None
) -> None:
    """Run the service with the settings of this file, until it is stopped. Raises GatewayError.

    `body`: shape and masses of what the servos of a simulated controller move. `fault`: which of its transfers fail.
    """
    faults = None if fault is None else unreliable.read(fault)
    settings = settings_file.load(config, simulated=simulated)
    with ExitStack() as processes:
        moved = None if body is None else processes.enter_context(BodyProcess(*body))
        board = None
        if settings.power.interface == SIMULATED:
            pages = (None, None) if moved is None else (moved.page, moved.sensed)
            board = processes.enter_context(BoardProcess(settings.power.outputs, *pages))
        _run(settings, simulated=simulated, body=moved, board=board, faults=faults)


def _run(
    settings: Settings,
    *,
    simulated: bool,
    body: BodyProcess | None,
    board: BoardProcess | None,
    faults: Faults | None,
) -> None:
    """Once it is ready, print its address and what to try next."""
    controller = "a simulated controller" if simulated else settings.spi.device
    robot = controller if body is None else "a simulated robot"

    def ready(config: zenoh.Config) -> None:
        if body is not None:
            body.connect(config)
        endpoints = [each for each in listen_endpoints(config) if body is None or each != endpoint(body.folder)]
        where = ", ".join(endpoints) or f"no port of its own ({settings.zenoh.config})"
        say(f"hexapod-gateway is ready: {where} → {robot} ({settings.spi.spoken})")
        say(next_step(endpoints, this_command()))

    physics = None if body is None else service.Physics(body.page, body.sensed, body.zenoh_id, body.folder)
    at = None if board is None else service.PowerBoardAt(board.channel, board.page)
    service.run(settings, simulated=simulated, physics=physics, board=at, faults=faults, on_ready=ready)


def next_step(endpoints: Sequence[str], command: str) -> str:
    """What to try, where the service listens on `endpoints`; `command` is how this program was called."""
    plain = [endpoint for endpoint in endpoints if not endpoint.startswith(("tls/", "quic/"))]
    if not plain:
        made = "NAME.json5 is made by: hexapod-gateway certs issue NAME --role operator, where ca.key is"
        return f"Try, on a laptop: hexapod-gateway check --zenoh-config NAME.json5 ({made})"
    connect = "" if DEFAULT_ENDPOINT in plain else f" --connect {plain[0]}"
    return f"Try, in a second terminal: {command} walk --forward 0.1 --seconds 5{connect}"
