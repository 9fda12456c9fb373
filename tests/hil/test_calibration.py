"""The calibration on the emulated device: byte for byte, the servos' own angles reach the wire, and nothing else."""

from pathlib import Path

import pytest

from schemas.calibration import ServoChange
from schemas.telemetry import Reason
from tests.hil.wire import SET_3, START_3, STOPS, Wire, start

pytestmark = pytest.mark.hil

STOP_3 = STOPS[2]
MIRRORED = {31: ServoChange(trim_deg=7.5), 32: ServoChange(trim_deg=-10.25, inverted=True)}


def test_the_same_commands_before_and_after(tmp_path: Path, wire: Wire) -> None:
    path = tmp_path / "calibration.toml"
    with start(tmp_path, wire, calibration={"path": str(path)}) as gateway, gateway.client() as client:
        assert client.start_leg(3, 90, 45, 120).accepted
        wire.expect(START_3)
        assert client.calibrate(MIRRORED).reason == Reason.INVALID, "leg 3 runs"
        assert client.set_leg(3, 91, 45, 120).accepted
        wire.expect(SET_3)
        assert client.stop(3).accepted
        wire.expect(STOP_3)
        assert client.calibrate(MIRRORED).accepted
        wire.expect_nothing()
        assert client.start_leg(3, 90, 45, 120).accepted
        wire.expect("0e011f01613220017c4b21017800")  # 97.50, 124.75, 120
        assert client.servo(32, "set", 179).reason == Reason.JOINT_LIMIT
        assert client.servo(32, "set", 0).accepted
        wire.expect("06022003a94b")  # 169.75
        assert client.start_leg(1, 90, 45, 120).accepted
        wire.expect("0e010b015a000c012d000d017800")
        assert client.estop().stop_frames == 6
        wire.expect(*STOPS)
