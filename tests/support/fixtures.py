"""Fixtures that many modules have: `gateway = gateway_fixture(SETTINGS)`, `anna = client_fixture("anna")`."""

from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any, Literal

import pytest

from gateway.client import Client
from tests.support.camera_server import CameraServer
from tests.support.console_process import Console, SignedIn
from tests.support.gateway_process import Gateway

Scope = Literal["package", "module", "function"]


def patient(silence_ms: float = 2000, **sections: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Settings that outlast a moment in which this machine is busy, and these `sections` of theirs.

    A leg may be silent for so long, a lease unused, and the gateway itself stopped before it rejects what waited.
    One test may start where the one before has just stopped: each command is one frame all the same.
    """
    settings: dict[str, dict[str, Any]] = {
        "watchdog": {"timeout_ms": silence_ms},
        "lease": {"ttl_ms": max(5000, silence_ms)},
        "limits": {"max_age_ms": max(3000, silence_ms), "takeover_deg_s": 0},  # a start goes to its angle at once
    }
    for section, values in sections.items():
        settings[section] = {**settings.get(section, {}), **values}
    return settings


def gateway_fixture(
    settings: Mapping[str, Mapping[str, Any]] = MappingProxyType({}),
    scope: Scope = "module",
    options: Sequence[str] = ("--sim",),
) -> Any:
    """Return a fixture: a gateway with these settings, for a module or for each test of it."""

    @pytest.fixture(scope=scope)
    def gateway(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Gateway]:
        with Gateway(tmp_path_factory.mktemp("gateway"), settings, options=options) as running:
            yield running

    return gateway


def client_fixture(source: str | None, *, rests: bool = False) -> Any:
    """Return a fixture: a client of the fixture `gateway`. `rests`: the previous test left it at rest."""

    @pytest.fixture
    def client(gateway: Gateway) -> Iterator[Client]:
        with gateway.client(source=source) as connected:
            if rests:
                connected.reset()
                assert connected.stop().accepted
            yield connected

    return client


def console_fixture(scope: Scope = "module") -> Any:
    @pytest.fixture(scope=scope)
    def console(gateway: Gateway, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Console]:
        with Console(tmp_path_factory.mktemp("console"), "--connect", gateway.endpoint) as running:
            yield running

    return console


def session_fixture(scope: Scope = "module") -> Any:
    @pytest.fixture(scope=scope)
    def session(console: Console) -> SignedIn:
        return console.sign_in()

    return session


def camera_fixture() -> Any:
    @pytest.fixture(scope="module")
    def camera() -> Iterator[CameraServer]:
        with CameraServer() as running:
            yield running

    return camera
