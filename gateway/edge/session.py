"""Zenoh configurations: the service's, from its settings, and a client's."""

import json
from pathlib import Path
from typing import Final

import zenoh

from gateway.edge import exposure
from gateway.edge.config_file import get, load_client_config, load_config, one_line
from gateway.errors import ConfigError, ZenohError
from gateway.limits import ACCEPT_PENDING, ACCEPT_TIMEOUT_MS, MAX_MESSAGE_SIZE, MAX_SESSIONS
from gateway.settings import ZenohSettings

_SCOUTING: Final = ("scouting/multicast/enabled", "scouting/gossip/enabled")


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
        _insert(config, "listen/endpoints", list(settings.listen), "zenoh.listen")
    if settings.connect or not settings.config:
        _insert(config, "connect/endpoints", list(settings.connect), "zenoh.connect")
    _scouting_off(config)
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


def client_config(endpoint: str | None, config_file: Path | None = None) -> zenoh.Config:
    """A client's configuration: the file (certificates); `endpoint` overrides the file's. Raises ConfigError."""
    config = load_client_config(config_file) if config_file is not None else zenoh.Config()
    config.insert_json5("mode", '"client"')
    if endpoint is not None:
        endpoint = endpoint if "/" in endpoint else f"tcp/{endpoint}"
        _insert(config, "connect/endpoints", [endpoint], "--connect")
    _insert(config, "listen/endpoints", [], "listen")
    _scouting_off(config)
    config.insert_json5("connect/retry", json.dumps(_RETRY))
    return config


_RETRY: Final = {"period_init_ms": 100, "period_max_ms": 500, "period_increase_factor": 1.5}
"""A client that lost the gateway was back after 0.35 s with this, after 1 to 2 s with Zenoh's own pauses."""


def open_session(config: zenoh.Config) -> zenoh.Session:
    """Open a session. Raises ZenohError with one line."""
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        endpoints = get(config, "listen/endpoints") or get(config, "connect/endpoints")
        raise ZenohError(why_not_opened(one_line(error), endpoints)) from error


CANNOT_CONNECT: Final = "Unable to connect"


def why_not_opened(text: str, endpoints: object) -> str:
    """Zenoh's `text` as a sentence that says what to do."""
    where = ", ".join(endpoints) if isinstance(endpoints, list) else str(endpoints)
    if "Address already in use" in text:
        return f"{where} is taken by another program (perhaps another gateway); stop it, or set another zenoh.listen"
    if "Cannot assign requested address" in text:
        return f"{where} is no address of this machine; set another zenoh.listen"
    if CANNOT_CONNECT in text:
        return f"no gateway answers on {where}; is it running, and does it know your certificate?"
    return f"Zenoh cannot be opened on {where}: {text}"


def _scouting_off(config: zenoh.Config) -> None:
    """Switch scouting off, unless the file turned it on: nobody finds the gateway by accident, and it finds nobody."""
    for key in _SCOUTING:
        if get(config, key) is not True:
            config.insert_json5(key, "false")


def _file_sets(path: str, section: str) -> bool:
    """Whether the file sets endpoints (Zenoh's default is not an empty list)."""
    return bool(get(load_config(Path(path)), f"{section}/endpoints") != get(zenoh.Config(), f"{section}/endpoints"))


def _insert(config: zenoh.Config, key: str, value: object, setting: str) -> None:
    try:
        config.insert_json5(key, json.dumps(value))
    except zenoh.ZError as error:
        raise ConfigError(f"{setting}: {value} will not do: {one_line(error)}") from error
