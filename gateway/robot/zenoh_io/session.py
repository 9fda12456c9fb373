"""The service's Zenoh configuration, made from its settings."""

import os
from pathlib import Path
from typing import Final

import zenoh

from gateway.host.settings_table import DEFAULT_LISTEN, ZenohSettings
from gateway.limits import ACCEPT_PENDING, ACCEPT_TIMEOUT_MS, MAX_MESSAGE_SIZE, MAX_SESSIONS
from gateway.robot.zenoh_io import exposure
from gateway.zenoh_config import get, insert, load_config, scouting_and_shared_memory_off

UNREAD_US: Final = 20_000
"""How long a reply may wait for a client that does not read, before Zenoh closes that client's link.

When a flood pushes a query out of its ring, Zenoh sends the query's end from a receiving thread that holds the ring's
lock, for which the loop waits. During 18 000 queries a second of a client that read no reply, watchdog Stops were
546 ms late with 500 ms here. With 20 ms none of 147 was later than 1.5 ms; one due in those 20 ms would wait for their
end. At that rate a client that reads may lose its link (twice in 32 s), at 50 queries a second not, down to 300 kbit/s.
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
"""A receiving thread for each session, in Zenoh's notation, so that no session waits for another. By default two
threads serve all sessions. A session that floods occupies one for 20 000 messages and more, and on a wildcard each
message goes into 26 rings; an emergency stop waited for that."""
_RUNTIME_VARIABLE: Final = "ZENOH_RUNTIME"


def receive_each_session_alone() -> None:
    """Set the number of Zenoh's receiving threads, unless the environment does. Call it before any use of Zenoh."""
    os.environ.setdefault(_RUNTIME_VARIABLE, RUNTIME)


def service_config(settings: ZenohSettings) -> zenoh.Config:
    """Return the Zenoh file's configuration with the settings and limits applied.

    Raises ConfigError if the file cannot be used, or would let anyone move the robot (`exposure.check`).
    """
    config = load_config(Path(settings.config)) if settings.config else zenoh.Config()
    if get(config, "mode") is None:
        config.insert_json5("mode", '"peer"')
    file_sets = get(config, "listen/endpoints") != get(zenoh.Config(), "listen/endpoints")  # Zenoh's is not empty
    if settings.listen is not DEFAULT_LISTEN or not file_sets:
        insert(config, "listen/endpoints", list(settings.listen), "zenoh.listen")
    scouting_and_shared_memory_off(config)
    # Otherwise a gateway without its listener would start without an error but could not be reached.
    config.insert_json5("listen/exit_on_failure", "true")
    config.insert_json5(_UNREAD_US_KEY, str(UNREAD_US))
    config.insert_json5(_MAX_MESSAGE_SIZE_KEY, str(MAX_MESSAGE_SIZE))
    for key, most in _MOST.items():
        config.insert_json5(key, str(min(most, get(config, key) or most)))
    exposure.check(config, allow_insecure=settings.allow_insecure)
    return config
