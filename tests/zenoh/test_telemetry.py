"""What a robot measures, over a real Zenoh: published while somebody listens, and answered."""

from schemas.keys import TELEMETRY
from schemas.telemetry import Telemetry
from tests.support.fixtures import gateway_fixture
from tests.support.gateway_process import Gateway
from tests.support.heard import Heard

gateway = gateway_fixture({"wire": {"name": "elkapod-2025"}})


def test_what_is_measured_is_published_while_somebody_listens_and_answered(gateway: Gateway) -> None:
    with gateway.client() as client:
        published = Heard(client, TELEMETRY, Telemetry).wait(lambda report: report.battery is not None)
        assert (published.tilt_deg, published.feet) == (0.0, (0.0,) * 6)
        answered = client.telemetry()
        assert answered is not None
        assert answered.time >= published.time
        assert answered.imu is not None
