"""An observer who declares without end: nothing is routed by it, and Stops come meanwhile."""

import time
from pathlib import Path
from typing import Any

from zenoh.handlers import RingChannel

from schemas import keys
from tests.support.secured import Secured

COUNT = 4000
WILDCARDS = ["hexapod/*", "**/hexapod/*", "hexapod/$*t$*", "*/*"]


def test_an_observers_declarations_reach_nothing(tmp_path: Path) -> None:
    """4000 of them, and wildcards that contain them all: nothing is routed by them, and Stops come meanwhile."""
    settings: dict[str, dict[str, Any]] = {"telemetry": {"frames": True}, "watchdog": {"timeout_ms": 50}}
    with (
        Secured(tmp_path, settings) as secured,
        secured.client("anna") as anna,
        secured.session("otto") as otto,
        secured.session("otto") as wild,
    ):
        exact = [otto.declare_subscriber(key, RingChannel(1000)) for key in (keys.STATE, keys.EVENT, keys.FRAME)]
        wanted = [f"hexapod/x{place}" if place % 50 else f"hexapod/$*{place}$*" for place in range(COUNT)]
        declared = []
        next_s = time.monotonic()
        for key in wanted + WILDCARDS:
            declared.append(wild.declare_subscriber(key, RingChannel(1)))
            if time.monotonic() > next_s:  # a Stop by the watchdog for each, while it goes on
                assert anna.start_leg(3, 90, 90, 90).accepted
                next_s = time.monotonic() + 0.1
        list(wild.get(keys.STATE, timeout=10))  # on the same link: all declarations have been read
        first = anna.state()
        assert anna.start_leg(3, 90, 90, 90).accepted
        assert anna.stop(3).accepted
        frames = exact[2].handler
        while frames.recv().payload.to_bytes().find(b'"cause":"command"') < 0:
            pass
        list(wild.get(keys.STATE, timeout=10))  # what was published before has come, or will not
        heard = [each.handler.try_recv() for each in declared]
        assert [str(sample.key_expr) for sample in heard if sample is not None] == []
        assert first.watchdog.expirations > 0
