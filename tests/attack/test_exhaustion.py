"""Visitors who take descriptors, sessions or memory, or keep an output: Stops are on time, and an operator gets in."""

import ipaddress
import os
import pty
import re
import select
import socket
import subprocess
import sys
import time
import tty
from collections.abc import Callable
from contextlib import ExitStack, closing, suppress
from pathlib import Path
from typing import Any

import pytest
import zenoh

from gateway.client import Client
from gateway.host.descriptors import NEEDED
from gateway.robot.zenoh_io.connection_limiter import VISITORS, shut_down
from gateway.zenoh.limits import MAX_SESSIONS
from schemas import keys
from schemas.command import MAX_PAYLOAD_BYTES
from schemas.words import Cause, Mode, Reason
from tests.benchmarks.processes import fds, rss_kb, threads
from tests.hil.bed import SpiTestbed
from tests.hil.wire import STOPS
from tests.support.gateway_process import HOST, Gateway, Secured, free_port
from tests.support.heard import frames, states
from tests.support.waiting import Closing, wait_until
from tests.zenoh.test_reports import read, value

LIMIT = NEEDED + 60
"""Enough to start, and few enough to be taken quickly."""
FEW = ["prlimit", f"--nofile={LIMIT}:{LIMIT}"]


# ---- silent connections


@pytest.mark.hil
def test_a_device_is_opened_again_while_strangers_hold_all_descriptors(tmp_path: Path) -> None:
    """They need no certificate: it takes connections to the TLS port that say nothing."""
    with (
        SpiTestbed() as spi_testbed,
        Secured(tmp_path, {"spi": {"framing": "plain"}}, bed=spi_testbed, prefix=FEW) as secured,
        secured.client("anna") as anna,
        ExitStack() as end,
    ):
        heard, pid = states(anna), secured.gateway.child.pid
        assert anna.start_leg(3, 90, 90, 90).accepted
        for _ in range(LIMIT):
            end.enter_context(closing(socket.create_connection((HOST, secured.port))))
        wait_until(lambda: fds(pid) == LIMIT)
        spi_testbed.remove_node()
        heard.wait(lambda state: state.mode is Mode.BUS_FAULT)
        wait_until(lambda: fds(pid) == LIMIT)  # the device's own has been taken, too
        known = len(spi_testbed.transfers)
        spi_testbed.restore_node()
        stopped = spi_testbed.wait_for_count(known + len(STOPS))[known:]
        assert {each.data.hex() for each in stopped} == set(STOPS)
        wait_until(lambda: anna.state().mode is Mode.IDLE)
        assert anna.estop().stop_frames == 6


OPENING = """
import os, resource, sys
import can, serial  # as at the service's start, when descriptors were left
from gateway.errors import SpiError
from gateway.host.descriptors import NO_SPARE, Spare
from gateway.host.settings_table import PowerSettings
from gateway.robot.power.line import PowerLine
from gateway.robot.power.slcan import Slcan
from gateway.robot.spi.uart import SerialUart
path, spare = os.ttyname(int(sys.argv[1])), Spare() if sys.argv[2] == "spare" else NO_SPARE
line = PowerLine(PowerSettings("slcan", path), print, spare=spare)
resource.setrlimit(resource.RLIMIT_NOFILE, (64, 64))
taken = list()
def take_all():
    try:
        while True:
            taken.append(os.dup(1))
    except OSError:
        pass
take_all()
try:
    SerialUart(path, spare=spare).close()
except SpiError as error:
    print(error)
take_all()
line._open()
print("the board", line._bus is not None)
"""


@pytest.mark.parametrize(
    ("spare", "said"), [("spare", "the board True\n"), ("none", r".*Too many open files.*\nthe board False\n")]
)
def test_a_uart_and_a_power_board_are_opened_where_no_descriptor_is_left(spare: str, said: str) -> None:
    """pyserial needs five for each."""
    line, end = os.openpty()
    tty.setraw(end)
    with os.fdopen(line), os.fdopen(end):
        command = [sys.executable, "-c", OPENING, str(end), spare]
        found = subprocess.run(command, pass_fds=[end], capture_output=True, text=True, check=False, timeout=60)
    assert re.fullmatch(said, found.stdout), found


# ---- sessions


@pytest.mark.parametrize("host", ["127.0.0.1", *(["::1"] if socket.has_dualstack_ipv6() else [])])
def test_one_connection_is_shut_down_by_its_peers_address(host: str) -> None:
    with socket.create_server((host, 0), family=socket.AF_INET6 if ":" in host else socket.AF_INET) as server:
        peers = [socket.create_connection(server.getsockname()[:2], 10) for _ in range(2)]
        accepted = [server.accept()[0] for _ in peers]
        shut_down({(ipaddress.ip_address(host), peers[0].getsockname()[1])})
        assert peers[0].recv(1) == b""
        accepted[1].send(b"x")
        assert peers[1].recv(1) == b"x"
        for each in (*peers, *accepted):
            each.close()


def test_an_operator_gets_in_beside_any_number_of_observers(tmp_path: Path) -> None:
    """Those beyond their share are turned away, and who was there before stays."""
    with Secured(tmp_path) as secured, ExitStack() as end:
        first = end.enter_context(closing(secured.session("otto")))
        others = [end.enter_context(closing(secured.session("otto"))) for _ in range(VISITORS - 1)]
        for _ in range(MAX_SESSIONS + 10 - VISITORS):
            with suppress(zenoh.ZError):  # all places are taken, or it was turned away while it came in
                others.append(end.enter_context(closing(secured.session("otto", **{"connect/timeout_ms": 300}))))
        begun_s = time.monotonic()
        with secured.client("anna") as anna:
            assert anna.estop().stop_frames == 6
            print(f"an operator got in, and its emergency stop was done, after {time.monotonic() - begun_s:.2f} s")
            wait_until(lambda: connected(others) < VISITORS)
            assert connected([first]) == 1
            assert anna.reset().accepted


def connected(sessions: list[zenoh.Session]) -> int:
    return sum(1 for session in sessions if session.info.links())


SILENT = 90
DESCRIPTORS = 260
THREADS = 128
"""What the service unit allows (TasksMax)."""
LATE_MS = 2000
"""A Stop is some 2 ms late at worst; one that waited for a silent connection came seconds later."""


@pytest.mark.parametrize("said", [b"", b"GET /metrics HTTP/1.1\r\nHost: rob"])
def test_silent_connections_keep_no_scrape_out_and_no_stop_waiting(tmp_path: Path, said: bytes) -> None:
    port = free_port()
    address = f"127.0.0.1:{port}"
    settings: dict[str, dict[str, Any]] = {
        "telemetry": {"metrics": address, "frames": True},
        "watchdog": {"timeout_ms": 20},
    }
    limited = ["prlimit", f"--nofile={DESCRIPTORS}", "--"]
    with Gateway(tmp_path, settings, prefix=limited) as gateway, gateway.client() as client, ExitStack() as crowd:
        before, pid = own_threads(gateway), gateway.child.pid
        for _ in range(SILENT):
            crowd.enter_context(socket.create_connection(("127.0.0.1", port), 10)).sendall(said)
        heard = frames(client)
        for count in range(1, 6):
            assert client.start_leg(3, 90, 45, 120).accepted
            heard.wait(lambda frame: frame.cause is Cause.WATCHDOG, count=count)
        assert value(read(address), "hexapod_frames_written_total", cause="watchdog") == 5
        assert own_threads(gateway) - before < SILENT / 2, "no thread for each connection"
        assert threads(pid) <= THREADS
        assert fds(pid) < DESCRIPTORS - 50
        latency = client.state().watchdog.stop_latency_us
        assert latency.max is not None
        assert latency.max < LATE_MS * 1000


def own_threads(gateway: Gateway) -> int:
    """Return how many threads are not Zenoh's: of those more start on a busy machine. A call may have one, too."""
    names = []
    for task in Path(f"/proc/{gateway.child.pid}/task").iterdir():
        with suppress(OSError):  # it has ended
            names.append((task / "comm").read_text())
    return sum(1 for name in names if not re.match(r"(app|net|acc|tx|rx)-\d", name))


BIG = 50_000_000
AT_MOST_MB = 15


def test_messages_of_50_mb_cost_no_memory(tmp_path: Path) -> None:
    """Without a limit, each was put together before access control looked at it: from 70 to 120 MB for one of these."""
    with Secured(tmp_path) as secured, secured.client("anna") as anna:
        # The file's own limit holds where it is used by others, such as a router; here it is the service's that counts.
        assert anna.start_leg(3, 90, 90, 90).accepted
        before_mb = rss_kb(secured.gateway.child.pid) / 1024
        for name in ("otto", "anna"):
            with secured.session(name) as session:
                session.put(keys.ESTOP, bytes(BIG), congestion_control=zenoh.CongestionControl.BLOCK)
        # Both are dropped, with or without their links; who asks for no more than the gateway takes is answered.
        with secured.client("anna") as again:
            ack = again.ask(keys.leg_command(3), {"x": "x" * (2 * MAX_PAYLOAD_BYTES)})
            assert ack.reason is Reason.TOO_LARGE
            assert again.estop().stop_frames == 6
        most_mb = rss_kb(secured.gateway.child.pid, "VmHWM") / 1024
        print(f"memory: {before_mb:.0f} MB before, {most_mb:.0f} MB at most")
        assert most_mb - before_mb < AT_MOST_MB


ANSWER_S = 20.0
"""For an answer, or a Stop, that takes some milliseconds: without the fix, neither came at all."""


class Stuck(Closing):
    """Something to write to that nobody reads."""

    def __init__(self, make: Callable[[], tuple[int, int]]) -> None:
        self._ours, self._theirs = make()
        self.path = f"/proc/{os.getpid()}/fd/{self._theirs}"
        # An opening of its own: the one that the gateway gets must go on blocking.
        self._more = os.open(self.path, os.O_WRONLY | os.O_NONBLOCK | os.O_NOCTTY)

    def close(self) -> None:
        for descriptor in (self._theirs, self._more, self._ours):
            os.close(descriptor)

    def fill(self) -> None:
        """Fill it to the last byte. A terminal passes some bytes on, and has room again."""
        while select.select([], [self._more], [], 0.05)[1]:
            for size in (4096, 1):
                with suppress(BlockingIOError):
                    while True:
                        os.write(self._more, b"." * size)


@pytest.mark.parametrize("full_before", [False, True])
@pytest.mark.parametrize("make", [os.pipe, pty.openpty])
def test_whatever_nobody_reads_holds_no_stop(
    tmp_path: Path, make: Callable[[], tuple[int, int]], full_before: bool
) -> None:
    """The watchdog's, the emergency stop's, those of the end. Nor its start, where nobody has read for long.

    A journal that is stuck: tests/box.
    """
    with Stuck(make) as stuck:
        if full_before:
            stuck.fill()
        redirected = ["sh", "-c", f'exec "$@" >{stuck.path} 2>{stuck.path}', "sh"]
        settings = {"telemetry": {"frames": True}}
        with (
            Gateway(tmp_path, settings, prefix=redirected, wait=False) as gateway,
            Client(gateway.endpoint, timeout_s=ANSWER_S) as client,
        ):
            heard = frames(client)  # once the gateway answers
            stuck.fill()
            assert client.start_leg(3, 90, 45, 120).accepted
            assert not client.ask(keys.leg_command(1), {"servos": []}).accepted, "which is said in the log"
            heard.wait(lambda frame: frame.cause is Cause.WATCHDOG, timeout_s=ANSWER_S)
            assert client.estop().stop_frames == 6
            gateway.child.terminate()
            heard.wait(lambda frame: frame.cause is Cause.SHUTDOWN, count=6, timeout_s=ANSWER_S)
            assert gateway.child.wait() == 0
