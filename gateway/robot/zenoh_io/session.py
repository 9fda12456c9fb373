"""The service's Zenoh configuration, from its settings."""

from pathlib import Path
from typing import Final

import zenoh

from gateway.limits import ACCEPT_PENDING, ACCEPT_TIMEOUT_MS, MAX_MESSAGE_SIZE, MAX_SESSIONS
from gateway.robot.edge import exposure
from gateway.robot.settings import ZenohSettings
from gateway.zenoh_config import get, insert, load_config, scouting_off

UNREAD_US: Final = 20_000
"""For how long an answer may wait for a laptop that does not read, before that laptop loses its link.

When a flood pushes a query out of its ring, or nothing answers it, Zenoh sends the query's end from a receiving thread
that holds the ring's lock, and the loop waits for that lock. With 500 ms, watchdog Stops were 546 ms late beside a
laptop that asked 18 000 times a second and read nothing. With 20 ms none of 147 was later than 1.5 ms; one that falls
due in these 20 ms would wait for their end. A client that asks as often and does read may lose its link (twice in
32 s). One that asks 50 times a second does not, down to 300 kbit/s.
"""
_UNREAD_US_KEY: Final = "transport/link/tx/queue/congestion_control/block/wait_before_close"

_MAX_MESSAGE_SIZE_KEY: Final = "transport/link/rx/max_message_size"
_MOST: Final = {
    "transport/unicast/max_sessions": MAX_SESSIONS,
    "transport/unicast/accept_pending": ACCEPT_PENDING,
    "transport/unicast/accept_timeout": ACCEPT_TIMEOUT_MS,
}
"""Upper limits; a Zenoh file may set lower ones."""


def service_config(settings: ZenohSettings) -> zenoh.Config:
    """The service's configuration: its Zenoh file, and what the settings add to it. Raises ConfigError."""
    config = load_config(Path(settings.config)) if settings.config else zenoh.Config()
    if get(config, "mode") is None:
        config.insert_json5("mode", '"peer"')
    listen_given = "listen" in settings.model_fields_set
    if listen_given or not settings.config or not _file_sets(settings.config, "listen"):
        insert(config, "listen/endpoints", list(settings.listen), "zenoh.listen")
    if settings.connect or not settings.config:
        insert(config, "connect/endpoints", list(settings.connect), "zenoh.connect")
    scouting_off(config)
    # Without its listener a gateway would open without an error and hear nobody.
    config.insert_json5("listen/exit_on_failure", "true")
    # Shared memory bypasses every size limit, and for such small messages local clients gain nothing by it.
    config.insert_json5("transport/shared_memory/enabled", "false")
    config.insert_json5(_UNREAD_US_KEY, str(UNREAD_US))
    config.insert_json5(_MAX_MESSAGE_SIZE_KEY, str(MAX_MESSAGE_SIZE))
    for key, most in _MOST.items():
        config.insert_json5(key, str(min(most, get(config, key) or most)))
    exposure.check(config, allow_insecure=settings.allow_insecure)
    return config


def _file_sets(path: str, section: str) -> bool:
    """Whether the file sets endpoints (Zenoh's default is not an empty list)."""
    return bool(get(load_config(Path(path)), f"{section}/endpoints") != get(zenoh.Config(), f"{section}/endpoints"))
