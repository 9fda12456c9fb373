"""How often systemd begins the service again: without an end what time may cure, and not what it does not cure."""

import re
from pathlib import Path

from gateway.onboard.serve import PAUSE_S

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
