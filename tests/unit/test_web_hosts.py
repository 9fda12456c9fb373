"""Whose requests a port on this machine answers."""

import pytest

from gateway.robot.runtime.metrics_page import LOOPBACK, is_one_of, may_ask


@pytest.mark.parametrize(
    ("host", "is_ours"),
    [
        ("127.0.0.1:9464", True),
        ("127.0.0.1", True),
        ("LocalHost:1", True),
        ("[::1]:9464", True),
        ("::1", True),
        ("evil.example:9464", False),
        ("127.0.0.1.evil.example", False),
        ("localhost.evil.example:9464", False),
        ("evil.example:localhost", False),
        ("localhost, evil.example", False),
        ("[evil.example]:9464", False),
        ("", False),
        (None, False),
    ],
)
def test_a_host_is_compared_whole(host: str | None, is_ours: bool) -> None:
    assert is_one_of(host, LOOPBACK) is is_ours


@pytest.mark.parametrize(
    ("host", "origin", "may"),
    [
        ("localhost:8765", None, True),
        ("localhost:8765", "http://localhost:8765", True),
        ("localhost:8765", "https://evil.example", False),
        ("localhost:8765", "http://localhost:8080", False),
        ("localhost:8765", "null", False),
        ("localhost:8765", "", False),
        ("evil.example:8765", None, False),
        ("evil.example:8765", "http://evil.example:8765", False),
    ],
)
def test_no_page_but_ours(host: str, origin: str | None, may: bool) -> None:
    assert may_ask(host, origin, LOOPBACK) is may
