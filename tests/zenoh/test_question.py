"""A question to a gateway that is gone: it is waited for without keeping a processor busy."""

import sys
from pathlib import Path
from types import FrameType
from typing import Any

import pytest

from gateway.client import Client
from gateway.errors import UnansweredError
from tests.support.gateway_process import Gateway

MOST_LOOKS = 500
"""In half a second: asked again every 50 ms, and each time a few calls. Without pauses they are many thousands."""


def test_waiting_for_a_gateway_that_is_gone_is_no_busy_loop(tmp_path: Path) -> None:
    looks = 0

    def count(_frame: FrameType, kind: str, called: Any) -> None:
        nonlocal looks
        looks += kind == "c_call" and called.__name__ == "monotonic"

    with Gateway(tmp_path) as gateway, Client(gateway.endpoint, timeout_s=0.5) as client:
        client.state()
        gateway.child.kill()
        gateway.child.wait()
        for ask in (client.state, client.stop):
            looks = 0
            sys.setprofile(count)
            try:
                with pytest.raises(UnansweredError):
                    ask()
            finally:
                sys.setprofile(None)
            assert 0 < looks < MOST_LOOKS
