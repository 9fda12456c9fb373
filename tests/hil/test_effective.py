"""A file that says plain, and a service whose unit says length-prefixed: no `stop-servos` jams the controller."""

import signal
from pathlib import Path
from typing import Any

import pytest

from tests.hil.wire import LATE_S, STOPS, Replay, Wire
from tests.support.command import run_here
from tests.support.gateway_process import COMMAND, Gateway

pytestmark = pytest.mark.hil

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
        stop = (*COMMAND, "stop-servos", "--config", str(gateway.config))
        by_hand = wire.bed.spawn(stop)
        assert by_hand.wait(LATE_S) == 0, str(by_hand)
        assert "The running gateway counts all servos as stopped" in by_hand.stdout
        assert 'has spi.framing = "plain", and the service uses "length-prefixed"; used the latter' in by_hand.stderr
        gateway.child.send_signal(signal.SIGKILL)
        gateway.child.wait(LATE_S)
        gateway.config.unlink()
        wire.skip()
        after = wire.bed.spawn(stop, env={"INVOCATION_ID": SERVICE["INVOCATION_ID"]})
        assert after.wait(LATE_S) == 0, str(after)
        assert after.stderr == ""
    with Gateway(tmp_path, quiet, bed=wire.bed, env=SERVICE) as again:
        story = run_here("incidents", "show", "last", "--config", str(again.config)).stdout
        told = ("ended without a word", "stop-servos has written a Stop to each of the six legs", "a gateway starts")
        places = [story.rindex(text) for text in told]
        assert places == sorted(places), story
    wire.expect_opening(*STOPS)
    replay = Replay(wire.framing).play(wire.bed.transfers)
    assert not replay.controller.corruptions
