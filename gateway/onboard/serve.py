"""`run`: starts the service, and prints its address once it is ready."""

import os
import sys
import time
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Final, NoReturn

import zenoh

from gateway.errors import GatewayError, SpiError, ZenohError
from gateway.host.settings_table import SIMULATED
from gateway.onboard.simulation_process import BoardProcess, BodyProcess
from gateway.people.physics.assumed import Assumed
from gateway.people.terminal import hint, say
from gateway.robot import service
from gateway.robot import settings as settings_file
from gateway.robot.host.systemd import NOTIFY_SOCKET, WATCHDOG
from gateway.robot.settings import Settings
from gateway.robot.spi.stop_all import stop_before_service
from gateway.robot.wires import SimulatedParts
from gateway.simulation.body import endpoint
from gateway.words import own_command
from gateway.zenoh.config import listen_endpoints

PAUSE_S: Final = 11.0
"""(PAUSE_S + the unit's RestartSec) × its StartLimitBurst exceeds its StartLimitIntervalSec."""
STOP_AGAIN_S: Final = 0.1
_CERTIFICATE: Final = "NAME.json5"


def serve(config: Path | None, *, simulated: bool, body: tuple[Path | None, Assumed] | None = None) -> None:
    """Run the service with the settings of this file until it is stopped. Print its address once it is ready.

    `body`: geometry file (None: the Elkapod's) and assumed masses of the simulated robot; None: no physics. Raises
    GatewayError.
    """
    settings, parts, is_ready = settings_file.load(config, simulated=simulated), SimulatedParts(simulated), False
    _reach_by(settings.zenoh.listen)
    with ExitStack() as processes:
        moved = None if body is None else processes.enter_context(BodyProcess(*body))
        if moved is not None:
            parts = SimulatedParts(simulated, moved.page, moved.sensed, moved.zenoh_id, moved.folder)
        if settings.power.interface == SIMULATED:
            board = processes.enter_context(BoardProcess(settings.power.outputs, parts.page, parts.sensed))
            parts = parts._replace(page=board.page, board_channel=board.channel)

        def ready(config: zenoh.Config) -> None:
            nonlocal is_ready
            is_ready = True
            endpoints, robot = listen_endpoints(config), "a simulated controller" if simulated else settings.device
            if moved is not None:
                moved.connect(config)
                endpoints, robot = [each for each in endpoints if each != endpoint(moved.folder)], "a simulated robot"
            where = ", ".join(endpoints) or f"no port of its own ({settings.zenoh.config})"
            spoken = settings.spi.framing if settings.wire.framed else settings.wire.name
            say(f"hexapod-gateway is ready: {where} → {robot} ({spoken})")
            _reach_by(endpoints)
            say(next_step(endpoints))

        try:
            service.run(settings, parts, ready)
        except (SpiError, ZenohError) as error:
            by_systemd = (WATCHDOG if simulated else NOTIFY_SOCKET) in os.environ  # `make run` has a socket, too
            if by_systemd and not is_ready:
                _pause(error, None if simulated else settings)
            raise


def _pause(error: GatewayError, settings: Settings | None) -> NoReturn:
    """Under systemd, wait before the end of a failed start that may succeed later. SIGTERM ends the pause.

    With the pause, such starts never reach the unit's start limit, which is for crashes. Meanwhile write Stops:
    servos may still run since a bus fault of the run before, and the device may return. Without `settings`: no Stops.
    """
    hint(f"hexapod-gateway: {error}")
    end_s = time.monotonic() + PAUSE_S
    while time.monotonic() < end_s:
        if settings is not None:
            stop_before_service(settings.wire, settings.spi, settings.controller)
        time.sleep(STOP_AGAIN_S)
    sys.exit(error.exit_code)


def _reach_by(endpoints: Sequence[str]) -> None:
    """Make the commands in later messages reach a service that listens on `endpoints`."""
    plain = own_command.plain(endpoints)
    own_command.reach_by(connect=plain, zenoh_config=_CERTIFICATE if plain is None and endpoints else None)


def next_step(endpoints: Sequence[str]) -> str:
    """Return the sentence on what to try with a service that listens on `endpoints`."""
    if own_command.plain(endpoints) is None:
        made = f"{_CERTIFICATE} is made by: hexapod-gateway certs issue NAME --role operator --dir DIR, where ca.key is"
        return f"Try, on a laptop: hexapod-gateway check --zenoh-config {_CERTIFICATE} ({made})"
    return f"Try, in a second terminal: {own_command.command('walk --forward 0.1 --seconds 5')}"
