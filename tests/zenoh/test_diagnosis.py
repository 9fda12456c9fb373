"""Every way in which a laptop does not reach the robot: one line names the step."""

import datetime as dt
import os
import shutil
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from gateway import certs
from gateway.certs import authority
from gateway.certs.files import read_certificate, read_key
from tests.support.child import Child
from tests.support.gateway_process import COMMAND, Gateway, free_port
from tests.support.tmux import Terminal

HOST = "127.0.0.1"
DAY = dt.timedelta(days=1)


class Robot:
    """A gateway over TLS, and the folder its certificates are made in."""

    def __init__(self, folder: Path, *, days: int = 30, now: dt.datetime | None = None) -> None:
        self.port = free_port()
        self.folder = folder / "D"
        self.endpoint = f"tls/{HOST}:{self.port}"
        certs.init(self.folder, [HOST], port=self.port, days=days, now=now)
        self.settings = {"zenoh": {"config": str(self.folder / "gateway.json5"), "listen": [self.endpoint]}}

    def file(self, name: str, role: str = "operator", *, days: int = 30, now: dt.datetime | None = None) -> str:
        """The Zenoh file of a new laptop."""
        certs.issue(self.folder, name, role, days=days, now=now)
        return str(self.folder / f"{name}.json5")


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Robot]:
    folder = tmp_path_factory.mktemp("robot")
    made = Robot(folder)
    with Gateway(folder, made.settings):
        yield made


def run(*arguments: str) -> Child:
    child = Child([*COMMAND, *arguments], os.environ)
    child.wait()
    child.close()
    return child


def said(*arguments: str) -> list[str]:
    """What a Stop that does not come through says."""
    child = run("send", "stop", "--timeout", "1", *arguments)
    assert child.returncode == 4, str(child)
    return [line.removeprefix("hexapod-gateway: ") for line in child.stderr.splitlines()]


@contextmanager
def deaf() -> Iterator[int]:
    """A port whose queue is full: a connection to it is never made, as behind a firewall that drops."""
    with socket.socket() as listener, socket.socket() as first, socket.socket() as second:
        listener.bind((HOST, 0))
        listener.listen(0)
        port = listener.getsockname()[1]
        first.connect((HOST, port))
        second.setblocking(False)
        second.connect_ex((HOST, port))
        yield port


# ---- name and TCP


def test_a_name_that_nobody_knows() -> None:
    (line,) = said("--connect", "tcp/robot.invalid:7447")
    assert line.startswith("no gateway answers on tcp/robot.invalid:7447: name: robot.invalid is unknown")
    assert " → check the name" in line


def test_a_port_where_nothing_listens() -> None:
    port = free_port()
    (line,) = said("--connect", f"tcp/{HOST}:{port}")
    assert f"TCP: {HOST} rejects port {port}: nothing listens there → does the gateway run" in line


def test_packets_that_are_lost() -> None:
    with deaf() as port:
        (line,) = said("--connect", f"tcp/{HOST}:{port}")
    assert f"TCP: {HOST} does not answer on port {port} → is the robot on" in line


def test_several_hosts_are_a_line_each(robot: Robot) -> None:
    file = Path(robot.file("hosts"))
    nobody = f"tls/{HOST}:{free_port()}"
    file.write_text(file.read_text().replace(f'["{robot.endpoint}"]', f'["{nobody}", "tls/robot.invalid:7447"]'))
    first, second = said("--zenoh-config", str(file))
    assert first.startswith(f"no gateway answers on {nobody}: TCP: ")
    assert second.startswith("no gateway answers on tls/robot.invalid:7447: name: ")


# ---- TLS


def test_plain_tcp_to_a_port_with_tls(robot: Robot) -> None:
    (line,) = said("--connect", f"tcp/{HOST}:{robot.port}")
    assert "TLS: the port wants TLS, and you dial it without → dial tls/…, and give --zenoh-config" in line


def test_tls_to_a_port_without(robot: Robot, tmp_path: Path) -> None:
    with Gateway(tmp_path) as plain:
        endpoint = plain.endpoint.replace("tcp/", "tls/")
        (line,) = said("--connect", endpoint, "--zenoh-config", robot.file("plain"))
    assert line.startswith(f"no gateway answers on {endpoint}: TLS: the port ")
    assert " → does the gateway use certificates?" in line


def test_no_certificate(robot: Robot) -> None:
    (line,) = said("--connect", robot.endpoint)
    assert "certificate: the robot wants a certificate, and you have none" in line


def test_a_host_that_the_certificate_does_not_name(robot: Robot) -> None:
    (line,) = said("--connect", f"tls/localhost:{robot.port}", "--zenoh-config", robot.file("misnamed"))
    assert "TLS: the robot's certificate does not name localhost → dial it by a name that it has" in line


def test_another_ca(robot: Robot, tmp_path: Path) -> None:
    certs.init(tmp_path / "E", [HOST], port=robot.port)
    certs.issue(tmp_path / "E", "eve", "operator")
    (line,) = said("--zenoh-config", str(tmp_path / "E" / "eve.json5"))
    assert "certificate: the robot's certificate is of another CA than yours" in line
    # Whoever trusts the robot, but shows what it does not know.
    shutil.copy(robot.folder / "ca.pem", tmp_path / "E" / "ca.pem")
    (line,) = said("--zenoh-config", str(tmp_path / "E" / "eve.json5"))
    assert "certificate: the robot does not know the CA of your certificate" in line


def test_a_laptop_whose_clock_is_behind(robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its certificate is not valid yet: made without the year before, and for a time to come."""
    monkeypatch.setattr(authority, "BACKDATE", dt.timedelta(0))
    (line,) = said("--zenoh-config", robot.file("young", now=dt.datetime.now(dt.UTC) + 5 * DAY))
    assert "certificate: young.pem is good from " in line
    assert "this machine's clock says " in line
    assert " → set the clock" in line


def test_a_robot_whose_certificate_has_expired(tmp_path: Path) -> None:
    """As after two years in a cupboard; the service itself would not start with it, but one that runs goes on."""
    robot = Robot(tmp_path)
    file = robot.file("anna")
    now = dt.datetime.now(dt.UTC)
    ca = authority.KeyPair(read_certificate(robot.folder / "ca.pem"), read_key(robot.folder / "ca.key"))
    # 6 s: for the service to start.
    short = authority.make_gateway(ca, [HOST], 1, now - DAY + dt.timedelta(seconds=6))
    (robot.folder / "gateway.pem").write_bytes(short.certificate_pem())
    (robot.folder / "gateway.key").write_bytes(short.key_pem())
    with Gateway(tmp_path, robot.settings):
        _wait_until(short.certificate.not_valid_after_utc)
        (line,) = said("--zenoh-config", file)
    assert "certificate: the robot's certificate has expired → hexapod-gateway certs renew gateway" in line


def _wait_until(when: dt.datetime) -> None:
    """A certificate's end is a time of the clock's, and nobody tells of it."""
    threading.Event().wait(max(0.0, (when - dt.datetime.now(dt.UTC)).total_seconds()) + 1.1)  # TLS counts whole seconds


# ---- role


def test_an_observer_is_informed_of_the_role(robot: Robot) -> None:
    (line,) = said("--zenoh-config", robot.file("otto", "observer"))
    assert line.startswith("no gateway answered: role: you may not command, as observer → ")


def test_a_certificate_without_a_role(robot: Robot) -> None:
    file = Path(robot.file("nobody"))
    file.write_text(file.read_text().replace("nobody.pem", "gateway.pem").replace("nobody.key", "gateway.key"))
    (line,) = said("--zenoh-config", str(file))
    assert "role: the connection is open, but your certificate is of gateway, which is no role" in line


# ---- check and watch


def names(child: Child, verdict: str) -> list[str]:
    return [line[9:24].strip() for line in child.stdout.splitlines() if line.startswith(f"{verdict} ")]


def test_check_goes_the_whole_way(robot: Robot) -> None:
    child = run("check", "--zenoh-config", robot.file("berta"))
    assert child.returncode == 0, str(child)
    assert names(child, "failure") == []
    way = ["certificate", "certificate", "name", "TCP", "TLS", "certificate", "role", "gateway"]
    assert [name for name in names(child, "ok") if name in way] == way
    assert child.stdout.splitlines()[-1].startswith("This machine reaches the gateway")


def test_check_of_an_observer(robot: Robot) -> None:
    child = run("check", "--zenoh-config", robot.file("olga", "observer"))
    assert child.returncode == 0, str(child)
    assert "you may not command, as observer" in child.stdout
    assert "role" in names(child, "warning")


def test_check_stops_at_the_step_that_fails(robot: Robot) -> None:
    child = run("check", "--zenoh-config", robot.file("carla"), "--connect", f"tls/{HOST}:{free_port()}")
    assert child.returncode == 1, str(child)
    assert names(child, "failure") == ["TCP"]
    assert child.stdout.splitlines()[-1] == "This machine does not reach the gateway: 1 failure."


def test_check_of_a_plain_gateway(tmp_path: Path) -> None:
    with Gateway(tmp_path) as gateway:
        child = gateway.run("check")
    assert child.returncode == 0, str(child)
    assert [name for name in names(child, "ok") if name in ("name", "TCP", "role", "gateway")] == [
        "name",
        "TCP",
        "role",
        "gateway",
    ]


def test_a_certificate_that_runs_out_while_one_watches(robot: Robot, tmp_path: Path) -> None:
    file = robot.file("dora", days=1, now=dt.datetime.now(dt.UTC) - DAY + dt.timedelta(seconds=8))
    with Terminal(tmp_path, [*COMMAND, "watch", "--zenoh-config", file]) as terminal:
        terminal.wait("IDLE")
        terminal.wait("SILENT", "dora.pem expired on", "get a new one from `hexapod-gateway certs renew`", timeout_s=30)
        terminal.press("q")
        assert terminal.wait_for_end() == 0
