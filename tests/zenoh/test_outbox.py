"""The right edge knows whether anybody listens."""

import time
from contextlib import closing

from zenoh.handlers import RingChannel

from gateway.host.settings_table import ZenohSettings
from gateway.robot.zenoh_io.outbox import ZenohOutbox
from gateway.robot.zenoh_io.session import service_config
from gateway.robot.zenoh_io.unknown_keys import UnknownKeys
from gateway.zenoh_config import client_config, open_session
from schemas.keys import STATE
from tests.support.gateway_process import free_port


def test_it_knows_whether_anyone_listens() -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    outbox = ZenohOutbox()
    assert not outbox.anyone_listens(STATE)
    with closing(open_session(service_config(ZenohSettings(listen=(endpoint,))))) as session:
        unknown_keys = UnknownKeys(session)  # which hears all of hexapod/, and counts for nobody
        outbox.open(session)
        assert comes_to_say(outbox, listened_to=False)
        with closing(open_session(client_config(endpoint))) as laptop:
            for key in (STATE, "hexapod/**"):
                subscriber = laptop.declare_subscriber(key, RingChannel(1))
                assert comes_to_say(outbox, listened_to=True)
                subscriber.undeclare()
                assert comes_to_say(outbox, listened_to=False)
        assert unknown_keys.poll() is None
        outbox.close()


def comes_to_say(outbox: ZenohOutbox, *, listened_to: bool) -> bool:
    """It says what it saw when it was last asked."""
    give_up_s = time.monotonic() + 10
    while outbox.anyone_listens(STATE) is not listened_to and time.monotonic() < give_up_s:
        time.sleep(0.001)
    return outbox.anyone_listens(STATE) is listened_to
