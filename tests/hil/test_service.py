"""The service as a user starts it, `stop-servos` and `check`, with the unmodified spidev on the emulated device.

The gateway is a process of its own; the test, or a command that it runs, is the client. Everything that reaches the
device is expected byte for byte and in order, so a frame too many fails a test as surely as one too few.
"""

import os
import signal
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from gateway.errors import ConfigError, DeviceHeldError
from gateway.model.frames import Framing, OneServo, Op, ServoOp
from gateway.onboard.computer import SELECT_BY_GPIO
from gateway.robot.spi.kernel import NO_SPIDEV
from schemas import keys
from schemas.robot import LEGS
from schemas.words import Kind, Reason
from tests.hil.bed import DEVICE, Setting, SpiTestbed, Transfer
from tests.hil.wire import EACH_FRAMING, LATE_S, START_3, STOPS, Replay, Wire, ended, settings_for, start
from tests.support.child import Child
from tests.support.command import run_here
from tests.support.gateway_process import COMMAND, Gateway, write_settings
from tests.support.heard import events, servos_on

pytestmark = pytest.mark.hil


# ---- start


@EACH_FRAMING
def test_the_start_sets_the_device_up_and_stops_all_legs_before_anyone_can_command(tmp_path: Path, wire: Wire) -> None:
    """Twice: before the service is loaded, and when it has opened the device."""
    with Gateway(tmp_path, settings_for(wire), bed=wire.bed):
        early, transfers = wire.expect_opening(*STOPS), wire.expect_opening(*STOPS)
        wire.expect_nothing()
        assert {each.opening for each in early} == {1}
        assert {(each.mode, each.bits_per_word, each.speed_hz) for each in transfers} == {(0, 8, 2_500_000)}
        assert {each.call for each in transfers} == {early[0].call + 1}, "one system call"
        begins_ns = [each.monotonic_ns for each in transfers]
        for before, begin_ns, next_ns in zip(transfers, begins_ns, begins_ns[1:], strict=False):
            zero = before.data == b"\0"
            assert before.pause_us == (100 if zero else 50)
            assert next_ns - begin_ns >= len(before.data) * 3200 + before.pause_us * 1000
        assert {each.opening for each in transfers} == {2}
        order = [type(event) for event in wire.bed.events if getattr(event, "opening", 2) == 2]
        assert order.index(Transfer) > max(place for place, kind in enumerate(order) if kind is Setting)
        assert {each.opening for each in wire.bed.settings} == {1, 2}


def test_the_first_stops_wait_for_nothing_that_the_service_loads(tmp_path: Path, spi_testbed: SpiTestbed) -> None:
    """This service ends before it opens the device. Without a framing: tests/attack/test_deaf_controller.py."""
    config = tmp_path / "gateway.toml"
    config.write_text(f'[limits]\nleg_rate_hz = -1\n[spi]\nframing = "{Framing.PLAIN}"\n')
    child = spi_testbed.spawn([*COMMAND, "run", "--config", str(config)])
    assert child.wait(LATE_S) == ConfigError.exit_code, str(child)
    assert [each.data.hex() for each in spi_testbed.transfers] == STOPS


# ---- emergency stop


@EACH_FRAMING
def test_an_emergency_stop_stops_latches_and_is_left_by_a_reset(gateway: Gateway, wire: Wire) -> None:
    with gateway.client() as client:
        for payload in (b"", b"{}", b"\xff\x00", b"x" * 5000):
            assert client.start_leg(3, 90, 45, 120).accepted
            wire.expect(START_3)
            client.session.put(keys.ESTOP, payload)
            wire.expect(*STOPS)
            assert client.start_leg(3, 90, 45, 120, check=False).reason is Reason.ESTOPPED
            assert client.stop(3).reason is Reason.ESTOPPED
            wire.expect(STOPS[2])  # rejected, and written all the same: a Stop too many harms nobody
            wire.expect_nothing()
            again = client.estop()
            assert (again.accepted, again.stop_frames) == (True, 6)
            assert again.latency_us is not None
            wire.expect(*STOPS)
            assert client.reset().accepted
            assert client.set_leg(3, 91, 45, 120, check=False).reason is Reason.SERVO_STOPPED
            wire.expect_nothing()


# ---- the end


@pytest.mark.alone
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGQUIT])
def test_a_signal_ends_it_with_stops_as_the_last_that_is_written(
    tmp_path: Path, wire: Wire, number: signal.Signals
) -> None:
    """Within a second, as the contract has it; a busy machine takes as much longer as it does for the start."""
    begun_s = time.monotonic()
    with start(tmp_path, wire) as gateway, gateway.client() as client:
        start_s = time.monotonic() - begun_s
        assert client.start_leg(3, 90, 45, 120).accepted
        wire.expect(START_3)
        heard = events(client)
        begun_s = time.monotonic()
        gateway.child.send_signal(number)
        assert gateway.child.wait(LATE_S) == 0, str(gateway.child)
        took_s = time.monotonic() - begun_s
        assert took_s < max(1.5, 2 * start_s)
        assert heard.wait(lambda event: event.kind is Kind.STOPPING)
        assert "Traceback" not in gateway.child.stderr
        wire.expect(*STOPS)
        wire.expect_opening(*STOPS, times=3)
        wire.expect_nothing()


# ---- whose device


def test_a_second_gateway_on_the_same_device_is_rejected(tmp_path: Path, gateway: Gateway, wire: Wire) -> None:
    with Gateway(tmp_path, settings_for(wire), bed=wire.bed, wait=False) as second:
        assert second.child.wait(LATE_S) == DeviceHeldError.exit_code
        assert second.child.stderr == f"hexapod-gateway: {DEVICE} is held by another gateway; stop that one first\n"
    wire.expect_nothing()
    with gateway.client() as client:
        assert client.start_leg(3, 90, 45, 120).accepted
    wire.expect(START_3)


# ---- stop-servos beside a running gateway: what the gateway then states is true, and no framing jams the controller


def test_whoever_starts_legs_meanwhile_the_state_is_what_the_controller_does(
    tmp_path: Path, wire: Wire, gateway: Gateway
) -> None:
    """Legs are started all the time, and once more when the gateway has said that it knows.

    Without Stops of the gateway's own, those would run on that were started after the only Stop from outside; and with
    starts taken as soon as it knows, the next Stops from outside would end them unseen.
    """
    with gateway.client() as client:
        heard = events(client)

        def start_until_known(count: int) -> None:
            known = False
            while not known:
                known = sum(event.kind is Kind.STOPPED_OUTSIDE for event in heard.all) >= count
                for leg in LEGS:
                    assert client.start_leg(leg, 90, 45, 120, check=False).reason in (None, Reason.SERVO_STOPPED)

        for count in range(1, 4):
            with ThreadPoolExecutor(1) as pool:
                starter = pool.submit(start_until_known, count)
                config = write_settings(tmp_path / "stop.toml", settings_for(wire))
                ended(wire.bed, "stop-servos", config)
                starter.result(LATE_S)
            replay = Replay(wire.framing).play(wire.bed.transfers)
            assert replay.energised_for_good() == servos_on(client.state())
            assert not replay.controller.corruptions


VARIABLE = "HEXAPOD_SPI__FRAMING"
SERVICE = {"INVOCATION_ID": "0a1b", VARIABLE: "length-prefixed"}
"""As the unit's drop-in gives them to the service."""


def test_stops_come_in_the_framing_that_the_controller_understands(
    tmp_path: Path, wire: Wire, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By hand beside the service; and once it was killed, though the unit's variable and the file are gone.

    The black box of the next start tells both.
    """
    monkeypatch.setenv("RUNTIME_DIRECTORY", str(tmp_path))
    quiet: dict[str, dict[str, Any]] = {"spi": {"framing": "plain"}, "state": {"path": str(tmp_path / "box")}}
    with Gateway(tmp_path, quiet, bed=wire.bed, env=SERVICE) as gateway:
        wire.expect_opening(*STOPS)
        by_hand = ended(wire.bed, "stop-servos", gateway.config)
        assert "The running gateway counts all servos as stopped" in by_hand.stdout
        assert 'has spi.framing = "plain", and the service uses "length-prefixed"; used the latter' in by_hand.stderr
        gateway.child.send_signal(signal.SIGKILL)
        gateway.child.wait(LATE_S)
        gateway.config.unlink()
        wire.skip()
        after = ended(wire.bed, "stop-servos", gateway.config, {"INVOCATION_ID": SERVICE["INVOCATION_ID"]})
        assert after.stderr == ""
    with Gateway(tmp_path, quiet, bed=wire.bed, env=SERVICE) as again:
        story = run_here("incidents", "show", "last", "--config", str(again.config)).stdout
        told = ("ended without a word", "stop-servos has written a Stop to each of the six legs", "a gateway starts")
        places = [story.rindex(text) for text in told]
        assert places == sorted(places), story
    wire.expect_opening(*STOPS)
    replay = Replay(wire.framing).play(wire.bed.transfers)
    assert not replay.controller.corruptions


# ---- what `check` states of the driver and disturbs, with each spidev and with none


def test_check_move_shows_that_a_driver_ignores_cs_change_and_what_to_do(
    tmp_path: Path, spi_testbed: SpiTestbed
) -> None:
    """The record shows a controller that takes only one frame while chip select is asserted: the others are lost."""
    wire = Wire(spi_testbed)
    spi_testbed.ignore_cs_change()
    with Gateway(tmp_path, settings_for(wire), bed=spi_testbed) as gateway:
        six_stops = b"".join(map(bytes.fromhex, STOPS))
        assert spi_testbed.wait_for_count(1)[0].data == six_stops
        child = spi_testbed.spawn([*COMMAND, "check", "--move", "--connect", gateway.endpoint])
        for answer in ("", "", "yes"):  # servo 61, at 90 degrees
            child.tell(answer)
        child.wait_for_output("All six legs were stopped at once", LATE_S)
        seen = Replay(wire.framing, selects=True).play(spi_testbed.transfers)
        assert 61 in seen.controller.energised
        child.tell("yes")
        child.tell("no")
        assert child.wait(LATE_S) == 1, str(child)
        assert SELECT_BY_GPIO in child.stdout
        left = Replay(wire.framing, selects=True).play(spi_testbed.transfers)
        assert left.controller.energised == frozenset(), "its last Stop is alone in its call"
        assert OneServo(61, ServoOp(Op.STOP)).data in [each.data for each in spi_testbed.transfers if each.delivered]


@pytest.fixture(
    params=["", 'raise ImportError("built for another processor")', "class SpiDev: pass"], ids=["spidev", "none", "3.6"]
)
def env(tmp_path: Path, request: pytest.FixtureRequest) -> dict[str, str]:
    """Return variables for a Python with spidev, without it, or with Debian's, which has no `open_path`."""
    if not request.param:
        return {}
    folder = tmp_path / "without"
    folder.mkdir()
    (folder / "spidev.py").write_text(f"{request.param}\n")
    return {"PYTHONPATH": os.pathsep.join([str(folder), *filter(None, [os.environ.get("PYTHONPATH")])])}


def line(child: Child, name: str) -> str:
    (found,) = [line for line in child.stdout.splitlines() if line[9:].startswith(name)]
    return found


def test_run_stop_servos_and_check_with_each_spidev_and_none(tmp_path: Path, wire: Wire, env: dict[str, str]) -> None:
    """`check` recognises a running gateway. It writes nothing, then or without one."""
    spi_testbed = wire.bed
    with Gateway(tmp_path, settings_for(wire), bed=spi_testbed, env=env) as gateway:
        opening = wire.expect_opening(*STOPS, times=2)
        assert {(each.mode, each.bits_per_word, each.speed_hz) for each in opening} == {(0, 8, 2_500_000)}
        settings = spi_testbed.settings
        beside = ended(spi_testbed, "check", gateway.config, env)
        assert "is the running gateway's" in line(beside, "SPI device")
        assert line(beside, "port").startswith("ok")
        assert "is in use by the running gateway" in line(beside, "port")
        assert spi_testbed.settings == settings
        wire.expect_nothing()
        assert {each.opening for each in wire.skip()} <= {opening[-1].opening}, "repeats of the gateway's Stops"
        ended(spi_testbed, "stop-servos", gateway.config, env)
        wire.expect_opening(*STOPS)
        gateway.child.terminate()
        assert gateway.child.wait(LATE_S) == 0
    begun = len(spi_testbed.transfers)
    alone = ended(spi_testbed, "check", gateway.config, env)
    assert not alone.stderr, str(alone)
    assert line(alone, "SPI device").startswith(f"ok       SPI device     {DEVICE} opens")
    assert (NO_SPIDEV in alone.stdout) is bool(env)
    assert line(alone, "SPI speed").endswith("2.5 MHz; an emergency stop takes 1.0 ms to write")
    assert line(alone, "SPI controller").startswith("ok       SPI controller ")
    assert line(alone, "SPI bus").startswith("ok       SPI bus ")
    assert line(alone, "framing").startswith("ok")
    assert alone.stdout.splitlines()[-1].startswith("This machine can run the service")
    assert len(spi_testbed.transfers) == begun
    assert ("speed", 2_500_000) in {(setting.kind, setting.value) for setting in spi_testbed.settings}
