"""What goes wrong out of sight is said: in the log, to systemd, in the state."""

import datetime as dt
import signal
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from gateway import certs
from gateway.client import Client
from gateway.people.commands.status import topics
from tests.support.gateway_process import Gateway, free_port

pytestmark = pytest.mark.full

DAY = dt.timedelta(days=1)


class Systemd:
    """The end of a notification socket."""

    def __init__(self, folder: Path) -> None:
        self.env = {"NOTIFY_SOCKET": str(folder / "notify")}
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.settimeout(20)
        self._socket.bind(self.env["NOTIFY_SOCKET"])

    def status(self, part: str) -> str:
        """Wait for a status with this in it."""
        while True:
            text = self._socket.recv(4096).decode()
            if "STATUS=" in text and part in text:
                return text.partition("STATUS=")[2]

    def close(self) -> None:
        self._socket.close()


@pytest.fixture
def systemd(tmp_path: Path) -> Iterator[Systemd]:
    systemd = Systemd(tmp_path)
    yield systemd
    systemd.close()


def test_an_expiry_is_said_before_it_comes(tmp_path: Path, systemd: Systemd, monkeypatch: pytest.MonkeyPatch) -> None:
    made, port = dt.datetime.now(dt.UTC) - 41 * DAY + dt.timedelta(minutes=1), free_port()
    with monkeypatch.context() as patch:
        patch.setattr(certs.folder, "now_utc", lambda: made)
        certs.folder.init(tmp_path / "D", ["127.0.0.1"], days=100, port=port)
    certs.folder.issue(tmp_path / "D", "anna", "operator")
    zenoh = {"config": str(tmp_path / "D" / "gateway.json5"), "listen": [f"tls/127.0.0.1:{port}"]}
    with Gateway(tmp_path, {"zenoh": zenoh}, env=systemd.env) as gateway:
        line = gateway.child.wait_for_output("gateway.pem expires on")
        assert ", in 59 days: then nobody can connect" in line
        assert "hexapod-gateway certs renew gateway --dir DIR, and copy gateway.pem here" in line
        assert "gateway.pem expires on" in systemd.status("expires")
        with Client(zenoh_config=tmp_path / "D" / "anna.json5", timeout_s=5) as client:
            state = client.state()
        assert topics(state)["certificate"].startswith("The robot's gateway.pem expires on")
    assert state.certificate is not None
    assert state.certificate.file == "gateway.pem"
    assert certs.expires_soon("gateway.pem", state.certificate.expires, state.time) is not None


def test_a_start_that_time_may_cure_pauses_under_systemd_alone(tmp_path: Path, systemd: Systemd) -> None:
    """It says why at once, and SIGTERM ends the pause. In a terminal it ends at once."""
    missing = {"spi": {"device": "/dev/spidev9.9", "framing": "plain"}}
    with Gateway(tmp_path, missing, options=(), wait=False) as gateway:
        assert gateway.child.wait() == 3
    with Gateway(tmp_path, missing, options=(), wait=False, env=systemd.env) as gateway:
        gateway.child.wait_for_output("/dev/spidev9.9 does not exist")
        gateway.child.terminate()
        assert gateway.child.wait() == -signal.SIGTERM
