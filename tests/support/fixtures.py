"""Fixtures that many modules have: `gateway = gateway_fixture(SETTINGS)`, `anna = client_fixture("anna")`."""

from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import Any, Literal

import pytest

from gateway.client import Client
from tests.support.gateway_process import Gateway


def gateway_fixture(
    settings: Mapping[str, Mapping[str, Any]] = MappingProxyType({}), scope: Literal["module", "function"] = "module"
) -> Any:
    """A fixture: a gateway with these settings, for a module or for each test of it."""

    @pytest.fixture(scope=scope)
    def gateway(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Gateway]:
        with Gateway(tmp_path_factory.mktemp("gateway"), settings) as running:
            yield running

    return gateway


def client_fixture(source: str | None, *, rests: bool = False) -> Any:
    """A fixture: a client of the fixture `gateway`, under this name; `rests`: which the test before left at rest."""

    @pytest.fixture
    def client(gateway: Gateway) -> Iterator[Client]:
        with gateway.client(source=source) as connected:
            if rests:
                connected.reset()
                assert connected.stop().accepted
            yield connected

    return client
