"""`hexapod-gateway watch`: the robot live in a terminal, with an emergency stop under the space bar.

Three kinds of threads, so that none holds up another: this one reads keys and never waits for anything else; one draws
(a terminal that is stuck, or a slow line, holds up the drawing alone); the link's speak Zenoh.
"""

import importlib.util
import json
import os
import sys
from functools import partial
from pathlib import Path

from gateway.client import DEFAULT_ENDPOINT, Client
from gateway.errors import ConfigError
from gateway.tools.terminal import hint
from gateway.zenoh_setup import client_config


def watch(connect: str | None, zenoh_config: Path | None, timeout_s: float) -> None:
    """Show the gateway until somebody presses q. Raises ConfigError; a gateway that is not there is waited for."""
    if importlib.util.find_spec("termios") is None:
        raise ConfigError("watch needs a Unix terminal; on Windows, run it in WSL")
    from gateway.tools.watch.screen import Watch  # noqa: PLC0415 (does not load without termios)

    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        raise ConfigError("watch needs a terminal; a program reads hexapod/state and hexapod/event instead")
    if connect is None and zenoh_config is None:
        connect = DEFAULT_ENDPOINT
    config = client_config(connect, zenoh_config)  # a faulty file is said now, and not on the screen
    endpoints = json.loads(config.get_json("connect/endpoints"))
    client = partial(Client, connect, zenoh_config=zenoh_config, source="hexapod-gateway watch", timeout_s=timeout_s)
    view = Watch(client, ", ".join(map(str, endpoints)))
    clean = view.run()
    if view.unconfirmed_stop:
        hint("The emergency stop was NOT confirmed: switch the servos' power off.")
    if not clean:
        # A thread is still inside Zenoh (a frozen gateway holds its close for ten seconds), or in a stuck terminal.
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(0)
