"""What a robot measures, over a real Zenoh: published while somebody listens, and answered; and rubbish is left out."""

from queue import SimpleQueue

from schemas.keys import TELEMETRY
from schemas.telemetry import Telemetry
from tests.support.fixtures import gateway_fixture
from tests.support.gateway_process import Gateway

gateway = gateway_fixture({"wire": {"name": "elkapod-2025"}})


def test_what_is_measured_is_published_while_somebody_listens_and_answered(gateway: Gateway) -> None:
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
