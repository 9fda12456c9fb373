"""The drill on the emulated device, with `stop-servos` beside the gateway: it passes, and the wire is as it says."""

from pathlib import Path

import pytest

from gateway.model.frames import OneServo, Op, ServoOp
from gateway.model.framing import Framing
from gateway.people.tools.drill.steps import STEPS
from tests.hil.bed import SpiTestbed
from tests.hil.wire import Replay, Wire, settings_for, start
from tests.support.gateway_process import COMMAND, write_settings

BUTTONS = {"required": 1, "timeout_ms": 600}
pytestmark = pytest.mark.hil


def test_it_passes_and_leaves_nothing_energised(tmp_path: Path, spi_testbed: SpiTestbed) -> None:
    wire = Wire(spi_testbed, Framing.LENGTH_PREFIXED)
    with start(tmp_path, wire, telemetry={"frames": True}, watchdog={"timeout_ms": 400}, buttons=BUTTONS) as gateway:
        config = write_settings(tmp_path / "stop.toml", settings_for(wire))
        options = ("--yes", "--late", "70", "--config", str(config), "--connect", gateway.endpoint)
        drill = wire.bed.spawn([*COMMAND, "drill", *options])
        assert drill.wait(60) == 0, str(drill)
        assert drill.stdout.count("PASS ") == len(STEPS) - 4, str(
            drill
        )  # all but --restart, and those of a power board
        assert "will go to 90° at once" in drill.stderr, "it says what moves, also where nobody is asked"
        transfers = wire.bed.transfers
        controller = Replay(wire.framing)
        controller.play(transfers)
        assert controller.energised_for_good() == frozenset()
        started = OneServo(11, ServoOp(Op.START, 90_00)).to_bytes()
        assert sum(transfer.data.endswith(started) for transfer in transfers) >= 5
