"""The service's Zenoh configuration, from its settings."""

import os
from pathlib import Path
from typing import Final

import zenoh

from gateway.host.settings_table import DEFAULT_LISTEN, ZenohSettings
from gateway.limits import ACCEPT_PENDING, ACCEPT_TIMEOUT_MS, MAX_MESSAGE_SIZE, MAX_SESSIONS
from gateway.robot.zenoh_io import exposure
from gateway.zenoh_config import get, insert, load_config, scouting_off

UNREAD_US: Final = 20_000
"""How long a reply may wait for a client that does not read, before Zenoh closes that client's link.

When a flood pushes a query out of its ring, Zenoh sends the query's end from a receiving thread that holds the ring's
lock, and the loop waits for that lock. With 500 ms, watchdog Stops were 546 ms late during 18 000 queries a second of a
client that read no reply. With 20 ms none of 147 was later than 1.5 ms; one that is due in these 20 ms would wait for
their end. A client that reads may lose its link at that rate (twice in 32 s). At 50 queries a second it does not, down
to 300 kbit/s.
"""
_UNREAD_US_KEY: Final = "transport/link/tx/queue/congestion_control/block/wait_before_close"

_MAX_MESSAGE_SIZE_KEY: Final = "transport/link/rx/max_message_size"
_MOST: Final = {
    "transport/unicast/max_sessions": MAX_SESSIONS,
    "transport/unicast/accept_pending": ACCEPT_PENDING,
    "transport/unicast/accept_timeout": ACCEPT_TIMEOUT_MS,
}
"""Upper limits; a Zenoh file may set lower ones."""

RUNTIME: Final = f"(rx:(worker_threads:{MAX_SESSIONS}))"
"""A receiving thread for each session, in Zenoh's own words. By default two threads receive from all sessions. A
session that floods keeps one for 20 000 messages and more, and on a wildcard each message goes into 26 rings. An
emergency stop waited for that. With a thread of its own, no session waits for another."""
_RUNTIME_VARIABLE: Final = "ZENOH_RUNTIME"


def receive_each_session_alone() -> None:
    """Set up Zenoh's receiving threads, unless the environment does. Call it before anything of Zenoh runs."""
    os.environ.setdefault(_RUNTIME_VARIABLE, RUNTIME)


def service_config(settings: ZenohSettings) -> zenoh.Config:
    """The Zenoh file's configuration with the settings and limits applied. Raises ConfigError."""
    config = load_config(Path(settings.config)) if settings.config else zenoh.Config()
    if get(config, "mode") is None:
        config.insert_json5("mode", '"peer"')
    listen_given = settings.listen is not DEFAULT_LISTEN
    if listen_given or not settings.config or not _file_sets(settings.config, "listen"):
        insert(config, "listen/endpoints", list(settings.listen), "zenoh.listen")
    scouting_off(config)
    # Otherwise a gateway without its listener would start without an error, unreachable.
    config.insert_json5("listen/exit_on_failure", "true")
    # Shared memory bypasses every size limit, and gains nothing for messages as small as these.
    config.insert_json5("transport/shared_memory/enabled", "false")
    config.insert_json5(_UNREAD_US_KEY, str(UNREAD_US))
    config.insert_json5(_MAX_MESSAGE_SIZE_KEY, str(MAX_MESSAGE_SIZE))
    for key, most in _MOST.items():
        config.insert_json5(key, str(min(most, get(config, key) or most)))
    exposure.check(config, allow_insecure=settings.allow_insecure)
    return config


def _file_sets(path: str, section: str) -> bool:
    """Whether the file sets endpoints. Compared with Zenoh's default, which is not an empty list."""
    return bool(get(load_config(Path(path)), f"{section}/endpoints") != get(zenoh.Config(), f"{section}/endpoints"))
