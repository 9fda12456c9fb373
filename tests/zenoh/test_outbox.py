"""The right edge knows whether anybody listens, and what a robot measures is published then."""

from contextlib import closing
from queue import SimpleQueue

from zenoh.handlers import RingChannel

from gateway.host.settings_table import ZenohSettings
from gateway.robot.zenoh_io.outbox import ZenohOutbox
from gateway.robot.zenoh_io.session import service_config
from gateway.robot.zenoh_io.unknown_keys import UnknownKeys
from gateway.zenoh.config import client_config, open_session
from schemas.keys import STATE, TELEMETRY
from schemas.telemetry import Telemetry
from tests.support.fixtures import gateway_fixture
from tests.support.gateway_process import Gateway, free_port
from tests.support.waiting import wait_until

gateway = gateway_fixture({"wire": {"name": "elkapod-2025"}})


def test_the_outbox_knows_whether_anyone_listens() -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    outbox = ZenohOutbox()
    assert not outbox.anyone_listens(STATE)
    with closing(open_session(service_config(ZenohSettings(listen=(endpoint,))))) as session:
        unknown_keys = UnknownKeys(session)  # which hears all of hexapod/, and counts for nobody
        outbox.open(session)
        assert not outbox.anyone_listens(STATE)
        with closing(open_session(client_config(endpoint))) as laptop:
            for key in (STATE, "hexapod/**"):
                subscriber = laptop.declare_subscriber(key, RingChannel(1))
                wait_until(lambda: outbox.anyone_listens(STATE))
                subscriber.undeclare()
                wait_until(lambda: not outbox.anyone_listens(STATE))
        assert unknown_keys.poll() is None
        outbox.close()


def test_what_is_measured_is_published_while_somebody_listens_and_answered(gateway: Gateway) -> None:
    """And rubbish is left out."""
    received: SimpleQueue[Telemetry] = SimpleQueue()
    with gateway.client() as client, gateway.client() as stranger:
        subscriber = client.on_telemetry(received.put)
        stranger.publish(TELEMETRY, {"battery": "full"})
        stranger.state()  # on the same link, behind it
        while (published := received.get(timeout=30)).battery is None:
            pass
        assert (published.tilt_deg, published.feet) == (0.0, (0.0,) * 6)
        subscriber.undeclare()
        answered = client.telemetry()
        assert answered is not None
        assert answered.time >= published.time
        assert answered.imu is not None
