"""The example of PCA9685 boards on the kernel's i2c-stub, which keeps what is written to two chips."""

import os
import sys
import tomllib
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

from smbus2 import SMBus

from gateway.client import Client
from tests.kernel.inside import wire
from tests.support.child import Child
from tests.support.gateway_process import READY, Gateway
from tests.support.plugin import declare

EXAMPLES: Final = Path(__file__).parents[3] / "examples"
WIRE: Final[dict[str, Any]] = tomllib.loads((EXAMPLES / "freenove" / "gateway.toml").read_text())["wire"]
LED0, FULL_OFF = 0x06, [0, 0, 0, 0x10]
MIDDLE: Final = [0, 0, 307 & 0xFF, 307 >> 8]
"""90 degrees are 1500 µs: so many counts of 4.88 µs."""


def _number() -> int:
    """Of the stub's bus."""
    for adapter in Path("/sys/bus/i2c/devices").glob("i2c-*"):
        if "stub" in (adapter / "name").read_text():
            return int(adapter.name.removeprefix("i2c-"))
    raise AssertionError("there is no i2c-stub")


def _outputs(number: int) -> list[list[int]]:
    """The four bytes of each servo's output."""
    with SMBus(number) as bus:
        return [bus.read_i2c_block_data(board, LED0 + 4 * channel, 4) for board, channel in WIRE["servos"].values()]


def service() -> str:
    """All legs start, an emergency stop stops them; started again, `stop-servos` does."""
    number = _number()
    with TemporaryDirectory() as folder:
        declare(Path(folder), "pca9685", "wire_pca9685:Pca9685")
        path = os.pathsep.join((folder, str(EXAMPLES / "wire_pca9685")))
        env = {**os.environ, "PYTHONPATH": path, "RUNTIME_DIRECTORY": folder}
        options = {name: value for name, value in WIRE.items() if name != "servos"}
        settings = {
            "wire": {**options, "bus": number},
            "wire.servos": WIRE["servos"],
            "watchdog": {"timeout_ms": 10_000},
            "limits": {"max_age_ms": 0},
        }
        with Gateway(Path(folder), settings, options=(), env=env, wait=False) as gateway:
            gateway.child.wait_for_output(READY, 180)
            with Client(gateway.endpoint, source="a scene", timeout_s=20) as client:
                client.wait_ready(60)
                _stopped_by(client, number, client.estop)
                assert client.reset().accepted
                _stopped_by(client, number, lambda: _stop_servos(gateway.config, env))
    return "18 outputs at 90 degrees, and full-off behind an emergency stop and stop-servos"


def _stopped_by(client: Client, number: int, stop: Any) -> None:
    client.start_legs(dict.fromkeys(wire.SIX, (90, 90, 90)))
    wire.wait_until(lambda: _outputs(number) == [MIDDLE] * 18, "pulses of 1500 µs", 30)
    stop()
    wire.wait_until(lambda: _outputs(number) == [FULL_OFF] * 18, "full-off", 30)


def _stop_servos(config: Path, env: dict[str, str]) -> None:
    with Child([sys.executable, "-m", "gateway", "stop-servos", "--config", str(config)], env) as child:
        assert child.wait(120) == 0, str(child)
