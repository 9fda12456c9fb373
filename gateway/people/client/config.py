"""A client's Zenoh configuration."""

import json
from pathlib import Path
from typing import Final

import zenoh

from gateway.zenoh_config import insert, load_client_config, scouting_off


def client_config(endpoint: str | None, config_file: Path | None = None) -> zenoh.Config:
    """A client's configuration: the file (certificates); `endpoint` overrides the file's. Raises ConfigError."""
    config = load_client_config(config_file) if config_file is not None else zenoh.Config()
    config.insert_json5("mode", '"client"')
    if endpoint is not None:
        endpoint = endpoint if "/" in endpoint else f"tcp/{endpoint}"
        insert(config, "connect/endpoints", [endpoint], "--connect")
    insert(config, "listen/endpoints", [], "listen")
    scouting_off(config)
    config.insert_json5("connect/retry", json.dumps(_RETRY))
    return config


_RETRY: Final = {"period_init_ms": 100, "period_max_ms": 500, "period_increase_factor": 1.5}
"""A client that lost the gateway was back after 0.35 s with this, after 1 to 2 s with Zenoh's own pauses."""
