"""The service as a process on the simulated controller: settings that only a process shows, start and end, mistakes."""

import datetime as dt
import json
import os
import re
import signal
import socket
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import pytest
import zenoh

from gateway import certs
from gateway.client import Client
from gateway.onboard.serve import PAUSE_S
from gateway.onboard.simulation_process import BoardProcess
from gateway.people.commands.status import topics
from gateway.robot.host.systemd import VARIABLES
from gateway.robot.service import REST_BEAT_S, SERVOS_FILE
from schemas import keys
from tests.support.child import Child, frozen
from tests.support.gateway_process import READY, Gateway, free_port
from tests.support.heard import frames
from tests.support.waiting import wait_until


def test_the_service_prints_where_it_is_and_what_to_try_and_a_token_shows_that_it_lives(tmp_path: Path) -> None:
    kinds: SimpleQueue[zenoh.SampleKind] = SimpleQueue()
    with Gateway(tmp_path) as gateway, gateway.client() as client:
        gateway.child.wait_for_output("Try")
        assert gateway.child.stdout.splitlines() == [
            f"{READY}: {gateway.endpoint} → a simulated controller (plain)",
            f"Try, in a second terminal: hexapod-gateway walk --forward 0.1 --seconds 5 --connect {gateway.endpoint}",
        ]
        tokens = client.session.liveliness()
        subscriber = tokens.declare_subscriber(keys.ALIVE, lambda sample: kinds.put(sample.kind), history=True)
        assert kinds.get(timeout=10) == zenoh.SampleKind.PUT
        gateway.child.kill()
        assert kinds.get(timeout=10) == zenoh.SampleKind.DELETE
        del subscriber


def test_a_gateway_beats_seldom_only_while_no_leg_runs_and_no_message_comes(tmp_path: Path) -> None:
    """The first beat after a start is early, too. Each beat writes its time into a file."""
    file = tmp_path / SERVOS_FILE

    def next_beat(before: str) -> str:
        wait_until(lambda: file.read_text() != before)
        return file.read_text()

    def periods_s(beats: int, happens: Callable[[], object] = lambda: None) -> Iterator[float]:
        text = next_beat(file.read_text())
        for _ in range(beats):
            happens()
            before, text = text, next_beat(text)
            yield (int(text.split()[0]) - int(before.split()[0])) / 1e9

    with Gateway(tmp_path, {"watchdog": {"timeout_ms": 10_000}}, env={"RUNTIME_DIRECTORY": str(tmp_path)}) as gateway:
        assert min(periods_s(4)) > 0.9 * REST_BEAT_S
        with gateway.client() as client:
            assert min(periods_s(4, lambda: client.set_leg(1, 90, 45, 120, check=False))) < 0.5 * REST_BEAT_S
            after_s: list[float] = []
            for _ in range(3):
                beat = next_beat(file.read_text())
                client.start_leg(1, 90, 45, 120)
                assert next_beat(beat).split()[1] == "1"
                after_s += [(int(file.read_text().split()[0]) - int(beat.split()[0])) / 1e9]
                assert min(periods_s(3)) < 0.5 * REST_BEAT_S
                client.stop(leg=1)
                wait_until(lambda: file.read_text().split()[1] == "0")
                next_beat(file.read_text())
            assert min(after_s) < 0.9 * REST_BEAT_S


def test_a_frozen_peer_holds_neither_an_answer_nor_the_end(tmp_path: Path) -> None:
    """Here Zenoh waits for a full link for longer than a client waits for its answer, and a link is full soon."""
    publisher = (
        "import sys, time\n"
        "from gateway.zenoh.config import client_config, open_session\n"
        "config = client_config(sys.argv[1])\n"
        "config.insert_json5('transport/link/tx/lease', '600000')\n"  # so Zenoh does not give it up before the end
        "config.insert_json5('transport/link/tcp/so_rcvbuf', '4096')\n"
        "session = open_session(config)\n"
        "heard = session.declare_subscriber('hexapod/frame', lambda frame: None)\n"
        "list(session.get('hexapod/state'))\n"
        "print('listening', flush=True)\n"
        "time.sleep(600)\n"
    )
    file, wait = tmp_path / "zenoh.json5", {"congestion_control": {"drop": {"wait_before_drop": 60_000_000}}}
    file.write_text(json.dumps({"transport": {"link": {"tcp": {"so_sndbuf": 4096}, "tx": {"queue": wait}}}}))
    settings: dict[str, dict[str, Any]] = {"telemetry": {"frames": True}, "limits": {"leg_rate_hz": 1000}}
    settings["zenoh"] = {"config": str(file)}
    with (
        Gateway(tmp_path, settings) as gateway,
        Child([sys.executable, "-c", publisher, gateway.endpoint], os.environ) as peer,
    ):
        peer.wait_for_output("listening")
        with frozen(peer.pid):
            with gateway.client() as client:
                published = frames(client)
                client.start_leg(1, 90, 45, 120)
                written = 0
                while written < 1000:
                    ack = client.set_leg(1, 90, 45, 120, check=False)
                    written += ack.accepted and not ack.coalesced
                    if not ack.accepted:  # the watchdog, on a busy machine
                        client.start_leg(1, 90, 45, 120, check=False)
                assert 0 < len(published.all) < written, "the frozen one's link is full"
            gateway.child.terminate()
            assert gateway.child.wait() == 0
        assert "ending without waiting for it" in gateway.child.stderr


def test_a_port_that_is_taken_ends_it_with_one_line(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        address = f"127.0.0.1:{taken.getsockname()[1]}"
        listens = f"tcp/{address} is taken by another program (perhaps another gateway); stop it, or set another"
        metrics = f"telemetry.metrics: {address} cannot be opened: Address already in use"
        for section, code, line in (
            ({"zenoh": {"listen": [f"tcp/{address}"]}}, 4, f"{listens} zenoh.listen"),
            ({"telemetry": {"metrics": address}}, 2, metrics),
        ):
            with Gateway(tmp_path, section, wait=False, env={"NOTIFY_SOCKET": "/nowhere"}) as gateway:  # by `make run`
                assert gateway.child.wait(PAUSE_S - 1) == code
                assert gateway.child.stderr == f"hexapod-gateway: {line}\n"


BROKEN = """
from gateway.robot.runtime import conductor
def broken(self, received, now_ns):
    raise RuntimeError("planted")
conductor.Conductor._receive = broken
"""
MUTE = f"""{BROKEN}
from gateway.robot.blackbox import recorder
def mute(self, detail):
    raise RuntimeError("the black box is broken, too")
recorder.Recorder.mistake = mute
"""
DEAF = """
from gateway.robot.zenoh_io import inbox
inbox.Inbox.makes_progress = lambda self: False
"""
HALF_OPEN = """
from gateway.robot import service
def broken(session, body_id):  # the inbox takes commands already
    raise RuntimeError("planted")
service.UnknownKeys = broken
"""
RUN = """
import atexit, os
from gateway import cli
atexit.register(os.write, 2, b"ended by the interpreter, which aborts while a thread is inside Zenoh")
cli.main()
"""


@pytest.mark.parametrize(
    ("planted", "last"),
    [(each, "hexapod-gateway: a mistake in the gateway ended it: planted") for each in (BROKEN, MUTE, HALF_OPEN)]
    + [(DEAF, "a thread that takes commands has ended or is stuck")],
)
def test_a_mistake_of_ours_stops_the_robot_and_ends_the_service(tmp_path: Path, planted: str, last: str) -> None:
    """Planted in the process's own code: nobody knows what state is left, so the robot must stand."""
    program = (sys.executable, "-X", "dev", "-c", planted + RUN)
    with Gateway(tmp_path, program=program, wait=BROKEN in planted) as gateway:
        if BROKEN in planted:
            with gateway.client() as client:
                client.publish(keys.leg_command(3), {})
                gateway.child.wait()
        assert gateway.child.wait() == 1
    assert last in gateway.child.stderr.splitlines()[-1]
    assert len(re.findall(r"servo \d\d stopped", gateway.child.stderr)) >= 2 * 18, "at the start, and at this end"


def test_a_disk_that_hangs_delays_no_start_for_its_black_box(tmp_path: Path) -> None:
    hangs = "import time\nfrom gateway.robot.blackbox import ring\nring.prepare = lambda folder: time.sleep(600)\n"
    with Gateway(tmp_path, {"state": {"path": str(tmp_path)}}, program=(sys.executable, "-c", hangs + RUN)):
        pass  # it is ready


# ---- what goes wrong out of sight is said: in the log, to systemd, in the state


@pytest.fixture
def systemd(tmp_path: Path) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as found:
        found.settimeout(20)
        found.bind(str(tmp_path / "notify"))
        yield found


@pytest.mark.full
def test_an_expiry_is_announced_early(tmp_path: Path, systemd: socket.socket, monkeypatch: pytest.MonkeyPatch) -> None:
    made, port = dt.datetime.now(dt.UTC) - dt.timedelta(days=41, minutes=-1), free_port()
    with monkeypatch.context() as patch:
        patch.setattr(certs.folder, "now_utc", lambda: made)
        certs.folder.init(tmp_path / "D", ["127.0.0.1"], days=100, port=port)
    certs.folder.issue(tmp_path / "D", "anna", "operator")
    listens = {"config": str(tmp_path / "D" / "gateway.json5"), "listen": [f"tls/127.0.0.1:{port}"]}
    with Gateway(tmp_path, {"zenoh": listens}, env={"NOTIFY_SOCKET": systemd.getsockname()}) as gateway:
        line = gateway.child.wait_for_output("gateway.pem expires on")
        assert ", in 59 days: then nobody can connect" in line
        assert "`sudo hexapod-gateway check` shows how to renew it, then restart the service" in line
        while "STATUS=" not in (said := systemd.recv(4096).decode()) or "gateway.pem expires on" not in said:
            pass
        with Client(zenoh_config=tmp_path / "D" / "anna.json5", timeout_s=5) as client:
            state = client.state()
        assert topics(state)["certificate"].startswith("The robot's gateway.pem expires on")
    assert state.certificate is not None
    assert state.certificate.file == "gateway.pem"
    assert certs.expires_soon("gateway.pem", state.certificate.expires, state.time) is not None


@pytest.mark.full
def test_a_start_that_time_may_cure_pauses_under_systemd_alone(tmp_path: Path, systemd: socket.socket) -> None:
    """It says why at once, and SIGTERM ends the pause. In a terminal it ends at once."""
    missing = {"spi": {"device": "/dev/spidev9.9", "framing": "plain"}}
    with Gateway(tmp_path, missing, options=(), wait=False) as gateway:
        assert gateway.child.wait() == 3
    with Gateway(tmp_path, missing, options=(), wait=False, env={"NOTIFY_SOCKET": systemd.getsockname()}) as gateway:
        gateway.child.wait_for_output("/dev/spidev9.9 does not exist")
        gateway.child.terminate()
        assert gateway.child.wait() == -signal.SIGTERM


def test_a_simulating_process_cannot_notify_in_the_services_name(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in VARIABLES:
        monkeypatch.setenv(name, "1")
    with BoardProcess((11,), None, None) as board:
        environment = Path(f"/proc/{board._process.pid}/environ").read_text()
    assert not [name for name in VARIABLES if name in environment]


def test_a_router_that_is_waited_for_holds_neither_stops_nor_the_end(tmp_path: Path) -> None:
    """The network keeps the service from starting. So does a name server that does not answer, for ten seconds."""
    waiting = {"endpoints": [f"tcp/127.0.0.1:{free_port()}"], "timeout_ms": -1, "exit_on_failure": True}
    (tmp_path / "zenoh.json5").write_text(json.dumps({"connect": waiting}))
    settings = {"zenoh": {"config": str(tmp_path / "zenoh.json5")}}
    with Gateway(tmp_path, settings, env={"PYTHONDEVMODE": "1"}, wait=False) as gateway:
        for leg in range(1, 7):
            gateway.child.wait_for_output(f"servo {leg}3 stopped")
        gateway.child.terminate()
        assert gateway.child.wait() == 0
        told = gateway.child.stderr
    assert "ready" not in gateway.child.stdout
    assert len(re.findall(r"servo \d\d stopped", told[told.index("the gateway ends") :])) >= 18
