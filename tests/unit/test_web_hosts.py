"""Whose requests a port on this machine answers."""

import pytest

from gateway.robot.runtime.metrics_page import LOOPBACK, may_ask


@pytest.mark.parametrize(
    ("host", "origin", "may"),
    [
        *((host, None, True) for host in ("127.0.0.1:9464", "127.0.0.1", "LocalHost:1", "[::1]:9464", "::1")),
        ("evil.example:9464", None, False),
        ("localhost.evil.example:9464", None, False),
        ("", None, False),
        (None, None, False),
        ("localhost:8765", "http://localhost:8765", True),
        ("localhost:8765", "https://evil.example", False),
        ("localhost:8765", "", False),
        ("evil.example:8765", "http://evil.example:8765", False),
    ],
)
def test_a_host_is_compared_whole_and_no_page_may_ask_but_ours(host: str | None, origin: str | None, may: bool) -> None:
    assert may_ask(host, origin, LOOPBACK) is may
