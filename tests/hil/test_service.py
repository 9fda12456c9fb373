"""The service as a user starts it, with the unmodified spidev on the emulated device, commanded through Zenoh.

The gateway is a process of its own; the test, or a command that it runs, is the client. Everything that reaches the
device is expected byte for byte and in order, so a frame too many fails a test as surely as one too few.
"""

import json
import signal
import time
from pathlib import Path

import pytest

from gateway.errors import ConfigError, DeviceHeldError
from gateway.model.frames import Framing
from gateway.people.client.payloads import leg_payload
from schemas import keys
from schemas.words import Kind, Mode, Reason
from tests.hil.bed import DEVICE, Setting, SpiTestbed, Transfer
from tests.hil.wire import EACH_FRAMING, LATE_S, START_3, STOPS, Wire, settings_for, start
from tests.support.gateway_process import COMMAND, Gateway
from tests.support.heard import events

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
    spi_testbed.heal()  # whose answer comes behind all reports
    assert [each.data.hex() for each in spi_testbed.transfers] == STOPS


# ---- commands


def test_bad_commands_write_no_more_than_stops(gateway: Gateway, wire: Wire) -> None:
    with gateway.client() as client:
        heard = events(client)
        bad = [{"servos": [{"op": "start", "angle_deg": angle}] * 3} for angle in (-0.01, 180.01, 1e300, True, "90")]
        bad += [{"servos": [{"op": "start", "angle_deg": 90}] * 2}, {"servos": []}, {}]
        for payload in bad:
            assert not client.ask(keys.leg_command(3), payload).accepted
        client.session.put(keys.leg_command(3), b"\xff{", encoding="application/json")
        client.session.put("hexapod/leg/7/cmd", json.dumps(leg_payload("start", (1, 2, 3))))
        heard.wait(lambda event: event.key == keys.leg_command(3) and event.reason is Reason.MALFORMED)
        heard.wait(lambda event: event.key == "hexapod/leg/7/cmd", timeout_s=LATE_S)
        assert client.state().mode is Mode.IDLE
        wire.expect(STOPS[2])  # what cannot be read may be a Stop of leg 3
        wire.expect_nothing()


# ---- silence, emergency stop


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
