"""A gateway with a simulated controller that runs on this machine, as `make run` starts it: then it is looked at.

What the machine would need for a real robot shows nothing about it, and it needs neither a device nor a framing.
"""

import datetime as dt
from collections.abc import Iterator

from gateway import __version__, own_command
from gateway.errors import ConfigError
from gateway.model.black_box.files import RING_FILE
from gateway.onboard.check import calibration, machine, network
from gateway.onboard.check.result import Result, ok, warning
from gateway.own_command import command
from gateway.robot import settings as settings_file
from gateway.robot.blackbox import paths
from gateway.robot.settings import Settings
from gateway.robot.zenoh_io.session import service_config
from gateway.zenoh_config import listen_endpoints
from schemas.telemetry import GatewayState, Mode


def simulated() -> tuple[Settings, GatewayState] | None:
    """The settings that are found without a file named, and what answers there; None: no simulated gateway does."""
    try:
        settings = settings_file.load(None, simulated=True)
        endpoints = listen_endpoints(service_config(settings.zenoh))
    except ConfigError:
        return None
    for endpoint in endpoints:
        if endpoint.startswith("tcp/") and (state := network.state_at(endpoint)) is not None and state.simulated:
            own_command.reach_by(connect=endpoint)
            return settings, state
    return None


def results(settings: Settings, state: GatewayState) -> Iterator[Result]:
    """The rows about a gateway that runs here on a simulated controller."""
    yield machine.python()
    yield _gateway(state)
    yield ok("SPI device", "none: its controller is simulated. For a real robot, end it and check again")
    yield calibration.kept(settings)
    yield from network.certificates(settings.zenoh, dt.datetime.now(dt.UTC))
    yield from network.ports(listen_endpoints(service_config(settings.zenoh)), gateway_runs=True)
    yield _black_box(settings)
    if state.telemetry.frames is False:
        yield warning(
            "frames", "are not published, so `record` has none", "telemetry.frames = true, as `make run` does"
        )
    yield machine.clock()


def _gateway(state: GatewayState) -> Result:
    name, said = "gateway", f"{state.version} runs on a simulated controller, and is {state.mode}"
    if state.version != __version__:
        return warning(name, f"{said}; this program is {__version__}", "end it, and start it again")
    if state.mode == Mode.ESTOPPED:
        return warning(name, said, f"{command('reset')} leaves the emergency stop")
    return ok(name, said)


def _black_box(settings: Settings) -> Result:
    folder = paths.folder_to_read(settings)
    if folder is None or not (folder / RING_FILE).exists():
        return warning("black box", "is off", "`make run` keeps one; for another gateway set state.path")
    return ok("black box", f"{folder}; hexapod-gateway incidents shows what it kept")
