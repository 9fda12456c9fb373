"""Visitors who take all file descriptors, or all sessions: the device is opened again, and an operator gets in."""

import ipaddress
import os
import re
import socket
import subprocess
import sys
import time
import tty
from contextlib import ExitStack, closing, suppress
from pathlib import Path

import pytest
import zenoh

from gateway.host.descriptors import NEEDED
from gateway.robot.zenoh_io.connection_limiter import VISITORS, shut_down
from gateway.zenoh.limits import MAX_SESSIONS
from schemas.telemetry import Mode
from tests.benchmarks.processes import fds
from tests.hil.bed import SpiTestbed
from tests.hil.wire import STOPS
from tests.support.heard import states
from tests.support.secured import HOST, Secured
from tests.support.waiting import wait_until

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
