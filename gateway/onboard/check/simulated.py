"""A gateway with a simulated controller that runs on this machine, as `make run` starts it: then it is looked at.

What the machine would need for a real robot shows nothing about it, and it needs neither a device nor a framing.
"""

from collections.abc import Iterator
from typing import Final

from gateway import __version__, own_command
from gateway.errors import ConfigError
from gateway.model.black_box.files import RING_FILE
from gateway.onboard.check import certificates, device, machine, network
from gateway.onboard.check.table import CheckedRobot, Probe, Result, Seen, judged, results, warning
from gateway.robot import settings as settings_file
from gateway.robot.blackbox import paths
from gateway.robot.settings import Settings
from gateway.robot.zenoh_io.session import service_config
from gateway.zenoh_config import listen_endpoints
from schemas.telemetry import GatewayState, Mode


def found() -> tuple[Settings, GatewayState] | None:
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


def look(settings: Settings, state: GatewayState) -> Iterator[Result]:
    """The lines about a gateway that runs here on a simulated controller."""
    robot, folder = CheckedRobot(settings, gateway_runs=True), paths.folder_to_read(settings)
    seen = Seen(version=state.version, own=__version__, mode=state.mode, folder=folder, frames=state.telemetry.frames)
    seen.keeps = folder is not None and (folder / RING_FILE).exists()
    probes = (device.CALIBRATION[0], certificates.CERTIFICATES[0], network.PORTS, machine.CLOCK)
    yield from results([machine.PYTHON], robot)
    yield from judged(GATEWAY, seen)
    yield from judged(BLACK_BOX, seen)
    yield from results(probes, robot)


_RUNS: Final = "{version} runs on a simulated controller, and is {mode}"
# fmt: off
GATEWAY: Final = Probe("gateway", lambda seen: [seen], (
    warning(lambda r: r.version != r.own, f"{_RUNS}; this program is {{own}}", "end it, and start it again"),
    warning(lambda r: r.mode == Mode.ESTOPPED, _RUNS, "{run[reset]} leaves the emergency stop"),
    warning(lambda r: not r.frames, f"{_RUNS}, without frames to record", "set telemetry.frames = true"),
), f"{_RUNS}. For a real robot, end it and check again")
BLACK_BOX: Final = Probe("black box", lambda seen: [seen], (
    warning(lambda r: not r.keeps, "is off", "`make run` keeps one; for another gateway set state.path"),
), "{folder}; hexapod-gateway incidents shows what it kept")
# fmt: on
