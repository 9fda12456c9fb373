"""A signal that arrives inside a Zenoh callback on the main thread is not lost."""

import logging
import os
import signal
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import pytest
import zenoh

from tests.support.gateway_process import Gateway

WAIT_S = 20.0


def ask_and_wait(session: zenoh.Session, ended: Callable[..., None]) -> None:
    session.get("nobody/here", zenoh.handlers.Callback(ended, ended, indirect=False))
    threading.Event().wait(WAIT_S)
    pytest.fail("the signal is lost")


@pytest.mark.parametrize(
    ("number", "raised"), [(signal.SIGINT, KeyboardInterrupt), (signal.SIGTERM, SystemExit)], ids=["ctrl-c", "sigterm"]
)
def test_it_ends_what_waits(
    number: signal.Signals, raised: type[BaseException], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The end of a query that nobody answers is delivered to the thread that asks."""
    monkeypatch.setattr(logging.getLogger("zenoh.handlers"), "filters", [])
    config = zenoh.Config()
    config.insert_json5("scouting/multicast/enabled", "false")
    threads: list[threading.Thread] = []

    def ended(_reply: zenoh.Reply | None = None) -> None:
        threads.append(threading.current_thread())
        os.kill(os.getpid(), number)

    before = signal.signal(number, (lambda *_: sys.exit()) if raised is SystemExit else signal.default_int_handler)
    try:
        with Gateway(tmp_path, {}) as gateway, gateway.client(), zenoh.open(config) as alone, pytest.raises(raised):
            ask_and_wait(alone, ended)
    finally:
        signal.signal(number, before)
    assert threads == [threading.main_thread()]
