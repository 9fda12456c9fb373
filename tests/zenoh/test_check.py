"""`check`: each of its looks, at real things where there are any: sockets, certificates, rights, files, a gateway."""

import datetime as dt
import os
import socket
import stat
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from gateway import certs
from gateway.people.tools.check import device, machine, network
from gateway.people.tools.check.result import Verdict
from gateway.robot.protocol.framing import Framing
from gateway.robot.settings import SpiSettings, ZenohSettings
from tests.support.certs_folder import DAY, NOW
from tests.support.gateway_process import COMMAND, Gateway, free_port, write_settings
from tests.support.router import zenoh_listening

OK, WARNING, FAILURE = Verdict.OK, Verdict.WARNING, Verdict.FAILURE


SPI = {"spi": {"framing": "length-prefixed"}}


def check(*arguments: str, env: dict[str, str] | None = None) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        [*COMMAND, "check", *arguments],
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
        env={**os.environ, **(env or {})},
    )


# ---- the command


def test_each_fault_of_the_configuration_is_a_line_and_the_rest_is_looked_at(tmp_path: Path) -> None:
    config = tmp_path / "gateway.toml"
    config.write_text('[spi]\nframing = "plain"\nspeed_hz = 0\n[wings]\n')
    said = check("--config", str(config), env={"HEXAPOD_LOG__LEVEL": "loud"})
    assert said.returncode == 1
    assert said.stderr == ""
    faults = [line for line in said.stdout.splitlines() if line.startswith("failure  configuration")]
    assert len(faults) == 3
    for place in ("spi.speed_hz", "wings", "HEXAPOD_LOG__LEVEL"):
        assert any(place in fault for fault in faults), said.stdout
    for name in ("Python", "clock", "systemd unit", "real-time"):
        assert any(line[9:].startswith(name) for line in said.stdout.splitlines()), said.stdout
    assert said.stdout.splitlines()[-1] == "This machine cannot run the service: 3 failures."


def test_a_file_that_is_not_there_is_a_failure_and_no_traceback() -> None:
    said = check("--config", "/nonexistent/gateway.toml")
    assert (said.returncode, said.stderr) == (1, "")
    assert "failure  configuration  /nonexistent/gateway.toml: there is no such file" in said.stdout


def test_every_line_has_a_verdict_a_name_and_where_it_is_not_ok_a_mend(tmp_path: Path) -> None:
    config = write_settings(tmp_path / "gateway.toml", {"zenoh": {"listen": [f"tcp/127.0.0.1:{free_port()}"]}, **SPI})
    *lines, _ = check("--config", str(config)).stdout.splitlines()
    assert len(lines) >= 11
    for line in lines:
        assert line.split()[0] in ("ok", "warning", "failure"), line
        assert (" → " in line) is not line.startswith("ok"), line


# ---- the device, as far as it needs none (the rest: tests/hil/test_check_device.py)


def test_a_file_is_no_device(tmp_path: Path) -> None:
    path = tmp_path / "spidev0.0"
    path.touch()
    result = device.device(SpiSettings(device=str(path)))
    assert result.verdict is FAILURE
    assert result.sentence.endswith("is no device node")


def test_a_character_device_that_speaks_no_spi() -> None:
    result = device.device(SpiSettings(device="/dev/null"))
    assert result.verdict is FAILURE
    assert "/dev/null cannot be opened" in result.sentence


@pytest.mark.parametrize(
    ("speed_hz", "verdict", "fix"),
    [
        (2_500_000, OK, ""),
        (2_500_001, WARNING, "set spi.speed_hz = 2500000"),
        (20_000_000, WARNING, "set spi.speed_hz = 2500000"),
        (50_000, OK, ""),
        (10_000, WARNING, "set spi.speed_hz = 2500000"),
        (1, WARNING, "set spi.speed_hz = 2500000"),
    ],
)
def test_speed(speed_hz: int, verdict: Verdict, fix: str, tmp_path: Path) -> None:
    result = device.speed(SpiSettings(speed_hz=speed_hz), sys_class=tmp_path)
    assert result.verdict is verdict
    assert result.fix.startswith(fix)


def test_speed_above_what_the_device_tree_allows(tmp_path: Path) -> None:
    node = tmp_path / "spidev0.0" / "device" / "of_node"
    node.mkdir(parents=True)
    (node / "spi-max-frequency").write_bytes((500_000).to_bytes(4, "big"))
    result = device.speed(SpiSettings(speed_hz=500_001), sys_class=tmp_path)
    assert result.verdict is WARNING
    assert "the 0.5 MHz that the device tree allows /dev/spidev0.0" in result.sentence
    assert device.speed(SpiSettings(speed_hz=500_000), sys_class=tmp_path).verdict is OK


@pytest.mark.parametrize(
    ("driver", "framing", "batch", "verdict"),
    [
        ("spi-bcm2835", "plain", True, OK),
        ("spi-dw", "plain", True, WARNING),
        (None, "plain", True, WARNING),
        ("spi-dw", "plain", False, OK),
        ("spi-dw", "length-prefixed", True, OK),
    ],
)
def test_the_driver_is_asked_whether_it_is_known_to_release_chip_select(
    driver: str | None, framing: Framing, batch: bool, verdict: Verdict, tmp_path: Path
) -> None:
    spi = tmp_path / "devices" / "fe204000.spi"
    device_of = spi / "spi_master" / "spi0" / "spi0.0"
    device_of.mkdir(parents=True)
    (tmp_path / "spidev0.0").mkdir()
    (tmp_path / "spidev0.0" / "device").symlink_to(device_of)
    if driver is not None:
        (tmp_path / driver).mkdir()
        (spi / "driver").symlink_to(tmp_path / driver)
    result = device.lists(SpiSettings(framing=framing, batch=batch), sys_class=tmp_path)
    assert result.verdict is verdict
    assert ("check --move" in result.fix) is (verdict is WARNING)
    assert driver is None or not batch or driver in result.sentence


def test_a_framing_that_nobody_has_said_comes_before_everything(tmp_path: Path) -> None:
    (tmp_path / "gateway.toml").write_text("[wings]\n")
    said = check("--config", str(tmp_path / "gateway.toml"))
    assert (said.returncode, said.stdout) == (2, "")
    assert [line.split(": ")[2] for line in said.stderr.splitlines()] == ["wings", "spi.framing", "spi.framing"]


def test_the_framing_that_moves_no_servo_is_a_warning() -> None:
    plain = device.framing(SpiSettings())
    assert plain.verdict is WARNING
    assert "length-prefixed" in plain.fix
    prefixed = device.framing(SpiSettings(framing=Framing.LENGTH_PREFIXED))
    assert prefixed.verdict is OK
    assert prefixed.sentence.endswith("wire angles from 1 up to 4 degrees are never sent")


@pytest.mark.parametrize("avoid_deg", [(), (1.5, 4), (1, 3.5)])
def test_deadly_angles_that_are_sent_are_a_warning(avoid_deg: tuple[float, ...]) -> None:
    found = device.framing(SpiSettings(framing=Framing.LENGTH_PREFIXED, avoid_deg=avoid_deg))
    assert found.verdict is WARNING
    assert "dies of these where one byte is lost" in found.sentence


# ---- ports


@pytest.fixture
def taken() -> Iterator[int]:
    """A port of the loopback on which another program listens."""
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        listener.listen()
        yield listener.getsockname()[1]


@pytest.mark.parametrize("link", ["tcp", "tls"])
def test_a_free_port(link: str) -> None:
    assert network.port(f"{link}/127.0.0.1:{free_port()}").verdict is OK


@pytest.mark.parametrize("endpoint", ["tcp/127.0.0.1:{}", "tls/127.0.0.1:{}", "tcp/localhost:{}#iface=lo"])
def test_a_taken_port(endpoint: str, taken: int) -> None:
    result = network.port(endpoint.format(taken))
    assert result.verdict is FAILURE
    assert "is taken by another program" in result.sentence
    assert network.port(endpoint.format(taken), gateway_runs=True).verdict is OK


def test_a_taken_udp_port() -> None:
    with socket.socket(type=socket.SOCK_DGRAM) as holder:
        holder.bind(("127.0.0.1", 0))
        port = holder.getsockname()[1]
        assert network.port(f"quic/127.0.0.1:{port}").verdict is FAILURE
        assert network.port(f"tcp/127.0.0.1:{port}").verdict is OK


def test_a_port_on_which_a_gateway_answers(tmp_path: Path) -> None:
    with Gateway(tmp_path) as gateway:
        result = network.port(gateway.endpoint)
    assert result.verdict is OK
    assert "is in use by a gateway that is idle, on a simulated controller" in result.sentence


@pytest.mark.parametrize(
    ("endpoint", "sentence"),
    [
        ("tcp/192.0.2.1:7447", "is no address of this machine"),
        ("tcp/127.0.0.1:99999", "cannot be listened on: ports end at 65535"),
        ("tcp/no-such-host.invalid:7447", "cannot be listened on"),
    ],
)
def test_a_port_that_cannot_be_had(endpoint: str, sentence: str) -> None:
    result = network.port(endpoint)
    assert result.verdict is FAILURE
    assert sentence in result.sentence
    assert result.fix


def test_what_is_no_port_is_not_tried() -> None:
    assert "was not tried" in network.port("unixsock-stream//run/hexapod.sock").sentence
    assert network.ports([], gateway_runs=False)[0].verdict is OK


def test_the_port_of_the_metrics(taken: int) -> None:
    result = network.metrics_port(f"127.0.0.1:{taken}", gateway_runs=False)
    assert result.verdict is FAILURE
    assert "telemetry.metrics" in result.fix
    assert network.metrics_port(f"127.0.0.1:{free_port()}", gateway_runs=False).verdict is OK


# ---- Zenoh's configuration and certificates


def test_an_open_door_is_a_failure_and_one_that_is_meant_a_warning(capfd: pytest.CaptureFixture[str]) -> None:
    config, results = network.zenoh_configuration(ZenohSettings(listen=("tcp/0.0.0.0:7447",)))
    assert config is None
    assert [result.verdict for result in results] == [FAILURE]
    meant = ZenohSettings(listen=("tcp/0.0.0.0:7447",), allow_insecure=True)
    config, results = network.zenoh_configuration(meant)
    assert config is not None
    assert [result.verdict for result in results] == [WARNING]
    assert "anyone who reaches tcp/0.0.0.0:7447 can move the robot" in results[0].sentence
    assert capfd.readouterr().err == ""  # told once, in its line


def folder(path: Path, *, days: int, now: dt.datetime = NOW) -> ZenohSettings:
    certs.init(path, ["127.0.0.1"], days=days, now=now)
    return ZenohSettings(config=str(path / "gateway.json5"))


@pytest.mark.parametrize(
    ("days", "verdict"),
    [(90, OK), (61, OK), (59, WARNING), (1, WARNING)],
)
def test_the_expiry_of_certificates(tmp_path: Path, days: int, verdict: Verdict) -> None:
    settings = folder(tmp_path / "D", days=days)
    ca, gateway = network.certificates(settings, NOW)
    assert ca.verdict is OK
    assert gateway.verdict is verdict
    assert f"good until {NOW + days * DAY:%Y-%m-%d}" in gateway.sentence
    if verdict is WARNING:
        assert gateway.fix.startswith("hexapod-gateway certs renew gateway")


def test_an_expired_certificate_is_one_failure(tmp_path: Path) -> None:
    settings = folder(tmp_path / "D", days=10, now=NOW - 11 * DAY)
    ca, result = network.certificates(settings, NOW)
    assert (ca.verdict, result.verdict) == (OK, FAILURE)
    assert "gateway.pem expired on" in result.sentence
    assert result.fix == "hexapod-gateway certs renew gateway, where ca.key is, and copy gateway.pem here"
    config = write_settings(tmp_path / "gateway.toml", {"zenoh": {"config": settings.config}, **SPI})
    said = check("--config", str(config))
    assert said.returncode == 1
    assert said.stdout.count("gateway.pem expired on") == 1


def test_a_clock_that_is_behind_is_named_as_the_fault(tmp_path: Path) -> None:
    settings = folder(tmp_path / "D", days=90)
    results = network.certificates(settings, NOW - 400 * DAY)
    assert {result.verdict for result in results} == {FAILURE}
    assert all("set the clock" in result.fix for result in results)


def test_a_missing_certificate(tmp_path: Path) -> None:
    settings = folder(tmp_path / "D", days=90)
    (tmp_path / "D" / "gateway.pem").unlink()
    (result,) = network.certificates(settings, NOW)
    assert result.verdict is FAILURE
    assert "gateway.pem" in result.sentence


def test_no_certificates_in_use() -> None:
    (result,) = network.certificates(ZenohSettings(), NOW)
    assert result.verdict is OK


def test_the_whole_of_a_robot_with_certificates(tmp_path: Path) -> None:
    settings = folder(tmp_path / "D", days=20)
    config = write_settings(tmp_path / "gateway.toml", {"zenoh": {"config": settings.config}, **SPI})
    said = check("--config", str(config))
    assert "warning  certificates   " in said.stdout
    assert "ok       Zenoh          " in said.stdout
    assert "port           tls/[::]:7447" in said.stdout


def test_a_listener_that_zenoh_does_not_open_is_tried(tmp_path: Path) -> None:
    """TCP beside a Zenoh file for TLS only: the port is free, and the service ends all the same."""
    certs.init(tmp_path / "D", ["127.0.0.1"])
    listen = f"tcp/127.0.0.1:{free_port()}"
    zenoh = {"config": str(tmp_path / "D" / "gateway.json5"), "listen": [listen]}
    with Gateway(tmp_path, {"zenoh": zenoh}, wait=False) as gateway:
        assert gateway.child.wait() == 4
    said = check("--config", str(write_settings(tmp_path / "robot.toml", {"zenoh": zenoh, **SPI})))
    assert said.returncode == 1
    (line,) = [line for line in said.stdout.splitlines() if line.startswith("failure  Zenoh")]
    assert f"cannot listen on {listen}: Unsupported protocol: tcp" in line
    zenoh["listen"] = [listen.replace("tcp/", "tls/")]
    said = check("--config", str(write_settings(tmp_path / "robot.toml", {"zenoh": zenoh, **SPI})))
    assert "cannot listen" not in said.stdout


def test_a_router_that_is_off_is_a_failure(tmp_path: Path) -> None:
    router = f"tcp/127.0.0.1:{free_port()}"
    config = write_settings(tmp_path / "robot.toml", {"zenoh": {"listen": [], "connect": [router]}, **SPI})
    (line,) = [line for line in check("--config", str(config)).stdout.splitlines() if line[9:].startswith("router")]
    assert line.startswith(f"failure  router         {router}: 127.0.0.1 rejects port ")
    assert "nobody behind it reaches this robot → start it there" in line
    with zenoh_listening(router):
        (line,) = [line for line in check("--config", str(config)).stdout.splitlines() if line[9:].startswith("router")]
        assert line.startswith("ok ")


# ---- the machine


def test_python_names_what_runs() -> None:
    result = machine.python()
    assert result.verdict is OK
    assert sys.executable in result.sentence


def test_the_clock() -> None:
    assert machine.clock().verdict in (OK, WARNING)  # whatever this machine's is
    assert [machine.clock_result(state).verdict for state in (0, 1, 4, 5, -1)] == [OK, OK, OK, WARNING, WARNING]


@pytest.fixture
def systemctl(tmp_path: Path) -> Path:
    """A program that says what `systemctl show` says, from the file `said` beside it."""
    program = tmp_path / "systemctl"
    program.write_text(f'#!/bin/sh\n[ "$1 $2" = "show hexapod-gateway" ] && cat {tmp_path}/said\n')
    program.chmod(program.stat().st_mode | stat.S_IXUSR)
    return program


@pytest.mark.parametrize(
    ("load", "active", "enabled", "verdict", "fix"),
    [
        ("loaded", "active", "enabled", OK, ""),
        ("loaded", "inactive", "enabled", WARNING, "sudo systemctl start hexapod-gateway"),
        ("loaded", "active", "disabled", WARNING, "sudo systemctl enable hexapod-gateway"),
        ("loaded", "failed", "enabled", FAILURE, "journalctl -u hexapod-gateway"),
        ("not-found", "inactive", "", WARNING, "sudo deploy/install.sh"),
        ("bad-setting", "inactive", "", FAILURE, "systemctl status hexapod-gateway"),
    ],
)
def test_the_unit(
    systemctl: Path, tmp_path: Path, load: str, active: str, enabled: str, verdict: Verdict, fix: str
) -> None:
    said = f"LoadState={load}\nActiveState={active}\nUnitFileState={enabled}\nResult=exit-code\n"
    (tmp_path / "said").write_text(said)
    result = machine.unit(booted=tmp_path, systemctl=str(systemctl))
    assert result.verdict is verdict
    assert result.fix.startswith(fix)


def test_no_systemd_and_one_that_does_not_answer(systemctl: Path, tmp_path: Path) -> None:
    none = machine.unit(booted=tmp_path / "absent", systemctl=str(systemctl))
    assert (none.verdict, "does not run systemd" in none.sentence) == (WARNING, True)
    mute = machine.unit(booted=tmp_path, systemctl=str(systemctl))  # there is no `said`: it fails
    assert (mute.verdict, "does not tell" in mute.sentence) == (WARNING, True)


def test_real_time_rights_are_tried() -> None:
    said = "import gateway.people.tools.check.machine as m; r = m.realtime(); print(r.verdict, r.sentence)"
    allowed = subprocess.run(["chrt", "--fifo", "20", "true"], capture_output=True, check=False).returncode == 0
    result = subprocess.run([sys.executable, "-c", said], capture_output=True, text=True, check=True).stdout
    assert result.startswith("ok" if allowed else "warning")


def test_without_real_time_rights_it_says_which_limit() -> None:
    said = (
        "import os, gateway.people.tools.check.machine as m; r = m.realtime(); print(r.verdict, r.sentence, r.fix);"
        "print(os.sched_getscheduler(0))"
    )
    bound = ["prlimit", "--rtprio=0", "--", *_without("sys_nice"), sys.executable, "-c", said]
    first, scheduler = subprocess.run(bound, capture_output=True, text=True, check=True).stdout.splitlines()
    assert first.startswith("warning priority 20 is not granted (RLIMIT_RTPRIO is 0)")
    assert "LimitRTPRIO" in first
    assert scheduler == str(os.SCHED_OTHER)


def test_what_it_tries_does_not_stay() -> None:
    """It asks on a thread that ends: the program that asked is scheduled as before."""
    machine.realtime()
    assert os.sched_getscheduler(0) == os.SCHED_OTHER


def test_a_port_that_this_user_may_not_have() -> None:
    code = "import gateway.people.tools.check.network as n; r = n.port('tcp/127.0.0.1:1'); print(r.verdict, r.sentence)"
    bound = [*_without("net_bind_service"), sys.executable, "-c", code]
    said = subprocess.run(bound, capture_output=True, text=True, check=True).stdout
    first_port = int(Path("/proc/sys/net/ipv4/ip_unprivileged_port_start").read_text())
    if first_port > 1:
        assert said == "failure tcp/127.0.0.1:1 may not be listened on by this user\n"
    else:  # a machine that lets everyone
        assert said == "ok tcp/127.0.0.1:1 is free\n"


def _without(right: str) -> list[str]:
    """A prefix that takes a right of root's away; others have it not."""
    return [] if os.geteuid() else ["setpriv", f"--bounding-set=-{right}", "--"]
