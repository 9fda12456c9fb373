"""Over QUIC a revoked operator kept all 64 sessions, and no operator found a place: not together with certificates."""

from pathlib import Path

import pytest

from gateway import certs
from tests.support.child import Child
from tests.support.command import run_here
from tests.support.gateway_process import COMMAND, free_port, write_settings


@pytest.mark.parametrize("direction", ["listen", "connect"])
def test_neither_the_service_nor_check_takes_it(tmp_path: Path, direction: str) -> None:
    folder = tmp_path / "D"
    certs.folder.init(folder, ["127.0.0.1"])
    file = folder / "gateway.json5"  # as somebody writes it who wants QUIC
    text = file.read_text().replace('protocols: ["tls"]', 'protocols: ["tls", "quic"]')
    quic = f"quic/127.0.0.1:{free_port()}"
    if direction == "connect":
        text = text.replace("connect: { endpoints: [] }", f'connect: {{ endpoints: ["{quic}"] }}')
    file.write_text(text)
    zenoh = {"config": str(file), "listen": [quic if direction == "listen" else f"tls/127.0.0.1:{free_port()}"]}
    settings = write_settings(tmp_path / "gateway.toml", {"zenoh": zenoh, "spi": {"framing": "plain"}})
    service = Child([*COMMAND, "run", "--sim", "--config", str(settings)], {})
    ended = service.wait(20)
    service.close()
    assert ended == 2, str(service)
    assert "over QUIC, revoked clients cannot be disconnected" in service.stderr
    checked = run_here("check", "--config", str(settings))
    assert checked.returncode == 1
    assert "write tls/ in place of quic/" in checked.stdout + checked.stderr
