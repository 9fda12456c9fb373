"""`stop-servos` beside a running gateway, each a process on the emulated device: what the gateway then says is true."""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from schemas.robot import LEGS
from schemas.telemetry import Kind, Reason
from tests.hil.wire import LATE_S, Replay, Wire, settings_for
from tests.support.gateway_process import COMMAND, Gateway, write_settings
from tests.support.heard import events, servos_on

pytestmark = pytest.mark.hil


def test_whoever_starts_legs_meanwhile_the_state_is_what_the_controller_does(
    tmp_path: Path, wire: Wire, gateway: Gateway
) -> None:
    """Legs are started all the time, and once more when the gateway has said that it knows.

    Without Stops of the gateway's own, those would run on that were started after the only Stop from outside; and with
    starts taken as soon as it knows, the next Stops from outside would end them unseen.
    """
    with gateway.client() as client:
        heard = events(client)

        def start_until_known(count: int) -> None:
            known = False
            while not known:
                known = sum(event.kind is Kind.STOPPED_OUTSIDE for event in heard.all) >= count
                for leg in LEGS:
                    assert client.start_leg(leg, 90, 45, 120, check=False).reason in (None, Reason.SERVO_STOPPED)

        for count in range(1, 4):
            with ThreadPoolExecutor(1) as pool:
                starter = pool.submit(start_until_known, count)
                config = write_settings(tmp_path / "stop.toml", settings_for(wire))
                child = wire.bed.spawn([*COMMAND, "stop-servos", "--config", str(config)])
                assert child.wait(LATE_S) == 0, str(child)
                starter.result(LATE_S)
            replay = Replay(wire.framing).play(wire.bed.transfers)
            assert replay.energised_for_good() == servos_on(client.state())
            assert not replay.controller.corruptions
