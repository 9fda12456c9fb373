"""How often systemd begins the service again: without an end what time may cure, and not what it does not cure."""

import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from gateway.errors import SpiError
from gateway.onboard import serve
from gateway.onboard.serve import PAUSE_S
from gateway.robot import service, settings

UNIT = (Path(__file__).parents[3] / "deploy/systemd/hexapod-gateway.service").read_text()
CRASHES_S = 5
"""A start on a Raspberry Pi 4, until it is killed."""


def setting(name: str) -> int:
    found = re.search(rf"^{name}=(\d+)$", UNIT, re.MULTILINE)
    assert found is not None
    return int(found[1])


def test_pauses_keep_starts_under_the_units_limit_and_crashes_reach_it() -> None:
    limit_s, burst, restart_s = (setting(each) for each in ("StartLimitIntervalSec", "StartLimitBurst", "RestartSec"))
    assert (PAUSE_S + restart_s) * burst > limit_s
    assert (CRASHES_S + restart_s) * burst < limit_s
    assert setting("TimeoutStartSec") > PAUSE_S


@pytest.mark.parametrize("simulated", [False, True])
def test_in_a_pause_a_real_robot_gets_stops(monkeypatch: pytest.MonkeyPatch, simulated: bool) -> None:
    """Its device may return, and its servos may run since a bus fault before the start."""
    stopped, pauses_s, used = list[Any](), list[float](), settings.Settings()
    monkeypatch.setattr("os.environ", {"NOTIFY_SOCKET": "@systemd", "WATCHDOG_USEC": "1000000"})
    monkeypatch.setattr(settings, "load", lambda *_, **__: used)
    monkeypatch.setattr(service, "run", lambda *_: (_ for _ in ()).throw(SpiError("told to fail")))
    monkeypatch.setattr(serve, "stop_before_service", lambda *of: stopped.append(of))
    monkeypatch.setattr(serve, "time", SimpleNamespace(monotonic=lambda: sum(pauses_s), sleep=pauses_s.append))
    with pytest.raises(SystemExit) as ended:
        serve.serve(None, simulated=simulated)
    assert (ended.value.code, round(sum(pauses_s))) == (SpiError.exit_code, PAUSE_S)
    assert stopped == ([] if simulated else [(used.wire, used.spi, used.controller)] * len(pauses_s))
