"""`check`: each of its looks, at real things where there are any: sockets, certificates, rights, files, a gateway."""

import os
import socket
import stat
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from gateway import certs
from gateway.onboard.check import device, machine, network
from gateway.onboard.check.result import Verdict
from gateway.robot.sections import SpiSettings, ZenohSettings
from tests.support.certs_folder import DAY, NOW
from tests.support.command import Ended, run_here
from tests.support.gateway_process import Gateway, free_port, write_settings
from tests.support.machine_tree import GPIOS, MachineTree
from tests.support.router import zenoh_listening

OK, WARNING, FAILURE = Verdict.OK, Verdict.WARNING, Verdict.FAILURE


SPI = {"spi": {"framing": "length-prefixed"}}


def check(config: Path) -> Ended:
    return run_here("check", "--config", str(config))


def lines(config: Path, name: str) -> list[str]:
    """What `check` prints under this name."""
    return [line for line in check(config).stdout.splitlines() if line[9:].startswith(name)]


# ---- the command


def test_each_fault_of_the_configuration_is_a_line_and_the_rest_is_looked_at(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HEXAPOD_LOG__LEVEL", "loud")
    config = tmp_path / "gateway.toml"
    config.write_text('[spi]\nframing = "plain"\nspeed_hz = 0\n[wings]\n')
    said = check(config)
    assert (said.returncode, said.stderr) == (1, "")
    *found, last = said.stdout.splitlines()
    faults = [line for line in found if line.startswith("failure  configuration")]
    assert len(faults) == 3
    for place in ("spi.speed_hz", "wings", "HEXAPOD_LOG__LEVEL"):
        assert any(place in fault for fault in faults), said.stdout
    for name in ("Python", "clock", "systemd unit", "real-time"):
        assert any(line[9:].startswith(name) for line in found), said.stdout
    for line in found:
        assert line.split()[0] in ("ok", "warning", "failure"), line
        assert (" → " in line) is not line.startswith("ok"), line
    assert last == "This machine cannot run the service: 3 failures."


def test_a_framing_that_nobody_has_said_comes_before_everything(tmp_path: Path) -> None:
    (tmp_path / "gateway.toml").write_text("[wings]\n")
    said = check(tmp_path / "gateway.toml")
    assert (said.returncode, said.stdout) == (2, "")
    assert [line.split(": ")[2] for line in said.stderr.splitlines()] == ["wings", *3 * ["spi.framing"]]


# ---- the device, as far as it needs none (the rest: tests/hil/test_check_device.py)


def test_what_is_no_spi_device(tmp_path: Path) -> None:
    file = tmp_path / "spidev0.0"
    file.touch()
    for path, sentence in ((file, "is no device node"), (Path("/dev/null"), "/dev/null cannot be opened")):
        result = device.device(SpiSettings(device=str(path)))
        assert result.verdict is FAILURE
        assert sentence in result.sentence


@pytest.mark.parametrize(
    ("speed_hz", "most_hz", "fix"),
    [
        (2_500_000, None, ""),
        (2_500_001, None, "set spi.speed_hz = 2500000"),
        (50_000, None, ""),
        (10_000, None, "set spi.speed_hz = 2500000"),
        (500_000, 500_000, ""),
        (500_001, 500_000, "set spi.speed_hz = 500000 or less"),
    ],
)
def test_speed(speed_hz: int, most_hz: int | None, fix: str, tmp_path: Path) -> None:
    """As it was measured, and as the device tree allows it."""
    node = tmp_path / "sys/class/spidev/spidev0.0/device/of_node"
    node.mkdir(parents=True)
    if most_hz is not None:
        (node / "spi-max-frequency").write_bytes(most_hz.to_bytes(4, "big"))
    result = device.speed(SpiSettings(speed_hz=speed_hz), root=tmp_path)
    assert result.verdict is (WARNING if fix else OK)
    assert result.fix.startswith(fix)


@pytest.mark.parametrize(
    ("kernel_hz", "gateway_runs", "fix"),
    [
        (125_000_000, False, ""),
        (2_500_000, False, ""),
        (2_499_999, False, "set spi.speed_hz = 2499999 or less"),
        (2_500_000, True, ""),
        (20_000_000, True, "sudo systemctl restart"),
        (10_000, True, "sudo systemctl restart"),
    ],
)
def test_a_speed_that_the_kernel_does_not_give_is_a_warning(
    kernel_hz: int, gateway_runs: bool, fix: str, tmp_path: Path
) -> None:
    result = device.speed(SpiSettings(), kernel_hz=kernel_hz, gateway_runs=gateway_runs, root=tmp_path)
    assert result.verdict is (WARNING if fix else OK)
    assert result.fix.startswith(fix)
    assert "the kernel gives" in result.sentence


@pytest.mark.parametrize(
    ("settings", "kernel_hz", "takes_ms"),
    [
        ({}, None, "0.6"),
        ({"framing": "length-prefixed"}, None, "1.0"),
        ({"framing": "length-prefixed", "frame_gap_us": 1000}, None, "12.4"),
        ({"framing": "length-prefixed"}, 1_000_000, "1.4"),
        ({"speed_hz": 1_000_000}, None, "1.0"),
    ],
)
def test_what_an_emergency_stop_takes(
    settings: dict[str, object], kernel_hz: int | None, takes_ms: str, tmp_path: Path
) -> None:
    """Bytes at the speed that the kernel gives, and a pause behind each transfer: an announced frame has two."""
    result = device.speed(SpiSettings.model_validate(settings), kernel_hz=kernel_hz, root=tmp_path)
    assert f"an emergency stop takes {takes_ms} ms to write" in result.sentence


def test_the_kernel_is_asked_for_the_speed_only_of_a_spidev(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    for path in (tmp_path / "file", tmp_path / "gone", Path("/dev/null")):
        assert device.kernel_hz(str(path)) is None


@pytest.mark.parametrize(
    ("cs_gpios", "framing", "verdict"),
    [(GPIOS, "plain", OK), (None, "plain", WARNING), (None, "length-prefixed", OK)],
)
def test_a_controller_that_drives_chip_select_may_keep_it_within_a_call(
    cs_gpios: bytes | None, framing: str, verdict: Verdict, tmp_path: Path
) -> None:
    """By the device tree, not by the driver's name."""
    MachineTree(tmp_path, cs_gpios=cs_gpios)
    settings = SpiSettings.model_validate({"framing": framing})
    result = device.lists(settings, root=tmp_path)
    assert result.verdict is verdict
    assert ("check --move" in result.fix) is (verdict is WARNING)
    assert ("spi-bcm2835" in result.sentence) is (cs_gpios is None)


def test_without_a_device_tree_nobody_knows_of_chip_select(tmp_path: Path) -> None:
    assert device.lists(SpiSettings(), root=tmp_path).verdict is WARNING


@pytest.mark.parametrize(
    ("settings", "verdict", "sentence"),
    [
        ({}, WARNING, "the published STM32 firmware jams in it"),
        ({"framing": "length-prefixed"}, OK, "wire angles from 1 up to 4 degrees are never sent"),
    ],
)
def test_a_framing_that_jams_the_published_firmware_is_a_warning(
    settings: dict[str, object], verdict: Verdict, sentence: str
) -> None:
    found = device.framing(SpiSettings.model_validate(settings))
    assert found.verdict is verdict
    assert sentence in found.sentence


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


@pytest.mark.full
@pytest.mark.parametrize(
    "endpoint", ["tcp/127.0.0.1:{}", "tls/127.0.0.1:{}", "tcp/localhost:{}#iface=lo", "quic/127.0.0.1:{}"]
)
def test_a_port_is_free_or_taken(endpoint: str, taken: int) -> None:
    result = network.port(endpoint.format(taken))
    assert result.verdict is FAILURE
    assert "is taken by another program" in result.sentence
    assert network.port(endpoint.format(taken), gateway_runs=True).verdict is OK
    assert network.port(endpoint.format(free_port())).verdict is OK


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


RENEW = "hexapod-gateway certs renew gateway, where ca.key is, and copy gateway.pem here"


@pytest.mark.parametrize(
    ("days_left", "verdict", "sentence", "fix"),
    [
        (61, OK, "is good until", ""),
        (59, WARNING, "days more", RENEW),
        (1, WARNING, "days more", RENEW),
        (-1, FAILURE, "gateway.pem expired on", RENEW),
        (490, FAILURE, "is good only from", "set the clock (timedatectl)"),
    ],
    ids=["good", "soon", "tomorrow", "expired", "a clock that is behind"],
)
def test_the_expiry_of_certificates(tmp_path: Path, days_left: int, verdict: Verdict, sentence: str, fix: str) -> None:
    days = 90
    certs.folder.init(tmp_path / "D", ["127.0.0.1"], days=days, now=NOW)
    settings = ZenohSettings(config=str(tmp_path / "D" / "gateway.json5"))
    ca, gateway = network.certificates(settings, NOW + (days - days_left) * DAY)
    assert ca.verdict is (FAILURE if days_left > days else OK), "it is good for longer"
    assert (gateway.verdict, gateway.fix) == (verdict, fix)
    assert sentence in gateway.sentence


def test_certificates_that_are_missing_or_not_in_use(tmp_path: Path) -> None:
    (result,) = network.certificates(ZenohSettings(), NOW)
    assert result.verdict is OK
    certs.folder.init(tmp_path / "D", ["127.0.0.1"])
    (tmp_path / "D" / "gateway.pem").unlink()
    (result,) = network.certificates(ZenohSettings(config=str(tmp_path / "D" / "gateway.json5")), NOW)
    assert result.verdict is FAILURE
    assert "gateway.pem" in result.sentence


def test_the_whole_of_a_robot_with_certificates(tmp_path: Path) -> None:
    """One that has expired is one failure."""
    certs.folder.init(tmp_path / "D", ["127.0.0.1"], days=10, now=NOW - 11 * DAY)
    zenoh = {"config": str(tmp_path / "D" / "gateway.json5")}
    said = check(write_settings(tmp_path / "gateway.toml", {"zenoh": zenoh, **SPI}))
    assert said.returncode == 1
    assert said.stdout.count("gateway.pem expired on") == 1
    assert "port           tls/[::]:7447" in said.stdout


def test_a_listener_that_zenoh_does_not_open_is_tried(tmp_path: Path) -> None:
    """TCP beside a Zenoh file for TLS only: the port is free, and the service ends all the same."""
    certs.folder.init(tmp_path / "D", ["127.0.0.1"])
    listen = f"tcp/127.0.0.1:{free_port()}"
    zenoh = {"config": str(tmp_path / "D" / "gateway.json5"), "listen": [listen]}
    with Gateway(tmp_path, {"zenoh": zenoh}, wait=False) as gateway:
        assert gateway.child.wait() == 4
    (line,) = lines(write_settings(tmp_path / "robot.toml", {"zenoh": zenoh, **SPI}), "Zenoh   ")[1:]
    assert f"cannot listen on {listen}: Unsupported protocol: tcp" in line
    zenoh["listen"] = [listen.replace("tcp/", "tls/")]
    (line,) = lines(write_settings(tmp_path / "robot.toml", {"zenoh": zenoh, **SPI}), "Zenoh   ")
    assert line.startswith("ok ")


def test_a_router_that_is_off_is_a_failure(tmp_path: Path) -> None:
    router = f"tcp/127.0.0.1:{free_port()}"
    config = write_settings(tmp_path / "robot.toml", {"zenoh": {"listen": [], "connect": [router]}, **SPI})
    (line,) = lines(config, "router")
    assert line.startswith(f"failure  router         {router}: 127.0.0.1 rejects port ")
    assert "nobody behind it reaches this robot → start it there" in line
    with zenoh_listening(router):
        (line,) = lines(config, "router")
        assert line.startswith("ok ")


# ---- the machine


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
        ("loaded", "active", "disabled", WARNING, "sudo systemctl enable --now hexapod-gateway"),
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
    assert (mute.verdict, "systemctl fails" in mute.sentence) == (WARNING, True)


REALTIME = (
    "import os, gateway.onboard.check.machine as m; r = m.realtime(); print(r.verdict, r.sentence, r.fix);"
    "print(os.sched_getscheduler(0))"
)


def test_real_time_rights_are_tried_and_do_not_stay() -> None:
    """It asks on a thread that ends: the program that asked is scheduled as before."""
    allowed = subprocess.run(["chrt", "--fifo", "20", "true"], capture_output=True, check=False).returncode == 0
    verdict, scheduler = _run([], REALTIME)
    assert verdict.startswith("ok" if allowed else "warning")
    assert scheduler == str(os.SCHED_OTHER)


def test_without_real_time_rights_it_says_which_limit() -> None:
    verdict, _ = _run(["prlimit", "--rtprio=0", "--", *_without("sys_nice")], REALTIME)
    assert verdict.startswith("warning priority 20 is not granted (RLIMIT_RTPRIO is 0)")
    assert "LimitRTPRIO" in verdict


def test_a_port_that_this_user_may_not_have() -> None:
    code = "import gateway.onboard.check.network as n; r = n.port('tcp/127.0.0.1:1'); print(r.verdict, r.sentence)"
    everyones = int(Path("/proc/sys/net/ipv4/ip_unprivileged_port_start").read_text()) <= 1
    (said,) = _run(_without("net_bind_service"), code)
    sentence = (
        "ok tcp/127.0.0.1:1 is free" if everyones else "failure tcp/127.0.0.1:1 may not be listened on by this user"
    )
    assert said == sentence


def _run(prefix: list[str], code: str) -> list[str]:
    command = [*prefix, sys.executable, "-c", code]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()


def _without(right: str) -> list[str]:
    """A prefix that takes a right of root's away; others have it not."""
    return [] if os.geteuid() else ["setpriv", f"--bounding-set=-{right}", "--"]
