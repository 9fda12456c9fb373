"""`stop-servos` beside a running gateway: what the gateway then says is true, and no framing jams the controller."""

import signal
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from schemas.robot import LEGS
from schemas.words import Kind, Reason
from tests.hil.wire import LATE_S, STOPS, Replay, Wire, ended, settings_for
from tests.support.command import run_here
from tests.support.gateway_process import Gateway, write_settings
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
                ended(wire.bed, "stop-servos", config)
                starter.result(LATE_S)
            replay = Replay(wire.framing).play(wire.bed.transfers)
            assert replay.energised_for_good() == servos_on(client.state())
            assert not replay.controller.corruptions


VARIABLE = "HEXAPOD_SPI__FRAMING"
SERVICE = {"INVOCATION_ID": "0a1b", VARIABLE: "length-prefixed"}
"""As the unit's drop-in gives them to the service."""


def test_stops_come_in_the_framing_that_the_controller_understands(
    tmp_path: Path, wire: Wire, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By hand beside the service; and once it was killed, though the unit's variable and the file are gone.

    The black box of the next start tells both.
    """
    monkeypatch.setenv("RUNTIME_DIRECTORY", str(tmp_path))
    quiet: dict[str, dict[str, Any]] = {"spi": {"framing": "plain"}, "state": {"path": str(tmp_path / "box")}}
    with Gateway(tmp_path, quiet, bed=wire.bed, env=SERVICE) as gateway:
        wire.expect_opening(*STOPS)
        by_hand = ended(wire.bed, "stop-servos", gateway.config)
        assert "The running gateway counts all servos as stopped" in by_hand.stdout
        assert 'has spi.framing = "plain", and the service uses "length-prefixed"; used the latter' in by_hand.stderr
        gateway.child.send_signal(signal.SIGKILL)
        gateway.child.wait(LATE_S)
        gateway.config.unlink()
        wire.skip()
        after = ended(wire.bed, "stop-servos", gateway.config, {"INVOCATION_ID": SERVICE["INVOCATION_ID"]})
        assert after.stderr == ""
    with Gateway(tmp_path, quiet, bed=wire.bed, env=SERVICE) as again:
        story = run_here("incidents", "show", "last", "--config", str(again.config)).stdout
        told = ("ended without a word", "stop-servos has written a Stop to each of the six legs", "a gateway starts")
        places = [story.rindex(text) for text in told]
        assert places == sorted(places), story
    wire.expect_opening(*STOPS)
    replay = Replay(wire.framing).play(wire.bed.transfers)
    assert not replay.controller.corruptions
