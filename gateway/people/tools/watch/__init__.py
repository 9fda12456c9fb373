"""`hexapod-gateway watch`: the robot live in a terminal, with an emergency stop under the space bar.

Three kinds of threads, so that none delays another. The calling thread reads keys and waits for nothing else. One
thread draws; a stuck terminal or a slow line delays only that. The link's threads speak Zenoh.
"""

import os
from functools import partial
from pathlib import Path
from typing import Final, NoReturn

from gateway.errors import ConfigError
from gateway.people.client import diagnosis
from gateway.people.client.blocking import Client
from gateway.people.terminal import check_terminal
from gateway.people.tools import why
from gateway.people.tools.watch.screen import WatchScreen
from gateway.zenoh_config import client_config, connect_endpoints

_OTHERWISE: Final = "; a program reads hexapod/state and hexapod/event instead"


def watch(connect: str | None, zenoh_config: Path | None, timeout_s: float) -> NoReturn:
    """Show the gateway until q, then end the process. Waits for a gateway that is not there yet.

    Raises ConfigError before it begins.
    """
    check_terminal("watch", _OTHERWISE, error=ConfigError)
    config = client_config(connect, zenoh_config)  # a faulty file is reported before the screen is taken
    client = partial(
        Client,
        connect,
        zenoh_config=zenoh_config,
        source="hexapod-gateway watch",
        timeout_s=timeout_s,
        explain=False,  # it tries again several times a second, and looks for the reason once in three seconds
    )
    view = WatchScreen(
        client,
        ", ".join(connect_endpoints(config)),
        partial(why.unreached, connect, zenoh_config),
        diagnosis.own_expiry(config),
    )
    code = view.show()
    # Not by the interpreter's own end: it aborts while a thread is inside Zenoh, and one may be for ten seconds (a
    # frozen gateway), or for ever in a stuck terminal. The lease and the session are closed by then.
    os._exit(code)
