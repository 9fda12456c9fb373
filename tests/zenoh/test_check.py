"""`check`: each of its looks, at real things where there are any: sockets, certificates, rights, files, a gateway."""

import json
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from gateway.onboard.check import security
from gateway.onboard.check.table import CheckedRobot
from tests.support.command import run_here
from tests.support.gateway_process import free_port, write_settings

SPI = {"spi": {"framing": "length-prefixed"}}


# ---- the command


def test_each_fault_of_the_configuration_is_a_line_and_the_rest_is_looked_at(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HEXAPOD_LOG__LEVEL", "loud")
    monkeypatch.setenv("HEXAPOD_CONNECT", f"tcp/127.0.0.1:{free_port()}")  # which hides no file that is named
    config = tmp_path / "gateway.toml"
    config.write_text('[spi]\nframing = "plain"\nspeed_hz = 0\n[wings]\n')
    said = run_here("check", "--config", str(config))
    assert (said.returncode, said.stderr) == (1, "")
    *found, last = said.stdout.splitlines()
    faults = [line for line in found if line.startswith("failure  configuration")]
    assert len(faults) == 3
    for place in ("spi.speed_hz", "wings", "HEXAPOD_LOG__LEVEL"):
        assert any(place in fault for fault in faults), said.stdout
    assert any(line[9:].startswith("systemd unit") for line in found), said.stdout
    for line in found:
        assert line.split()[0] in ("ok", "warning", "failure"), line
        assert (" → " in line) is not line.startswith("ok"), line
    assert last.startswith("This machine cannot run the service: 3 failures, ")


def test_as_json_the_same_is_for_programs(tmp_path: Path) -> None:
    config = write_settings(tmp_path / "gateway.toml", SPI)
    shown, found = (run_here("check", "--config", str(config), *options) for options in ((), ("--json",)))
    report = json.loads(found.stdout)
    assert found.returncode == shown.returncode == int(not report["passed"])
    told = [f"{each['verdict']:8} {each['name']:14} {each['sentence']}" for each in report["checks"]]
    assert [line.partition(" → ")[0] for line in shown.stdout.splitlines()[:-1]] == told


# ---- ports (one on which a gateway answers: tests/hil/test_check_device.py)


@pytest.fixture
def taken() -> Iterator[int]:
    """A port of the loopback on which another program listens, and over UDP as well."""
    with socket.socket() as listener, socket.socket(type=socket.SOCK_DGRAM) as holder:
        listener.bind(("127.0.0.1", 0))
        listener.listen()
        port = listener.getsockname()[1]
        holder.bind(("127.0.0.1", port))
        yield port


TAKEN, FREE, RUNS = "is held by another program", "is free", "by the running gateway"


@pytest.mark.parametrize(
    ("endpoint", "sentence"),
    [
        *((f"{each}:TAKEN", TAKEN) for each in ("tcp/127.0.0.1", "tls/127.0.0.1", "quic/127.0.0.1")),
        *((f"{each}:FREE", FREE) for each in ("tcp/127.0.0.1", "tls/127.0.0.1", "quic/127.0.0.1")),
        ("tcp/127.0.0.1:TAKEN#iface=lo", TAKEN),
        ("tcp/192.0.2.1:7447", "is not there yet (Cannot assign requested address)"),
        ("tcp/127.0.0.1:99999", "cannot be listened on: ports end at 65535"),
        ("tcp/no-such-host.invalid:7447", "is not there yet ("),
        ("unixsock-stream//run/hexapod.sock", "was not tried"),
    ],
)
def test_a_port(endpoint: str, sentence: str, taken: int) -> None:
    where = endpoint.replace("TAKEN", str(taken)).replace("FREE", str(free_port()))
    assert said(CheckedRobot(), where).startswith(f"{where} {sentence}")
    if sentence is TAKEN:
        assert said(CheckedRobot(gateway_runs=True), where) == f"{where} is in use {RUNS}"


def said(robot: CheckedRobot, where: str) -> str:
    found = security.port(robot, where)
    assert found is not None
    return found.sentence
