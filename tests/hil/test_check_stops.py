"""`check --stops` on the emulated device, with `stop-servos` beside the gateway: the wire is as it reports."""

from pathlib import Path

import pytest

from gateway.model.frames import OneServo, Op, ServoOp
from gateway.model.framing import Framing
from gateway.onboard.check.stops import STEPS
from tests.hil.bed import SpiTestbed
from tests.hil.wire import Replay, Wire, settings_for, start
from tests.support.gateway_process import COMMAND, write_settings

pytestmark = [pytest.mark.hil, pytest.mark.alone]


def test_it_passes_and_leaves_nothing_energised(tmp_path: Path, spi_testbed: SpiTestbed) -> None:
    wire = Wire(spi_testbed, Framing.LENGTH_PREFIXED)
    with start(tmp_path, wire, telemetry={"frames": True}, watchdog={"timeout_ms": 1000}) as gateway:
        config = write_settings(tmp_path / "stop.toml", settings_for(wire))
        options = ("--yes", "--late", "1000", "--config", str(config), "--connect", gateway.endpoint)
        check = wire.bed.spawn([*COMMAND, "check", "--stops", *options])
        assert check.wait(60) == 0, str(check)
        # All but --restart, and those of a power board.
        assert check.stdout.count("PASS ") == len(STEPS) - 4, str(check)
        assert "will go to 90° at once" in check.stderr, "it says what moves, also where nobody is asked"
        transfers = wire.bed.transfers
        controller = Replay(wire.framing)
        controller.play(transfers)
        assert controller.energised_for_good() == frozenset()
        started = OneServo(11, ServoOp(Op.START, 90_00)).to_bytes()[:4]  # soon behind a Stop it starts where it stood
        assert sum(started in transfer.data for transfer in transfers) >= 4
