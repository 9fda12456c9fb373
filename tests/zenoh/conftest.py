"""What tests with Zenoh in this process share."""

from collections.abc import AsyncIterator
from contextlib import closing

import pytest
import zenoh

from gateway.host.settings_table import ZenohSettings
from gateway.robot.zenoh_io.session import service_config
from gateway.zenoh_config import open_session
from tests.support.gateway_process import free_port


@pytest.fixture
async def session() -> AsyncIterator[zenoh.Session]:
    """A session as the service opens it, on a port of its own."""
    settings = ZenohSettings(listen=(f"tcp/127.0.0.1:{free_port()}",))
    with closing(open_session(service_config(settings))) as opened:
        yield opened
