"""A device that fails, goes and comes back, or is slow: the emulated kernel device does it to the service.

Afterwards the robot stands, whatever was under way has been rejected, and whoever wants it to move must start it again.
"""

import errno
import signal
import sys
import time
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from gateway.client import Client
from gateway.model.framing import Framing
from schemas import keys
from schemas.telemetry import Ack, Event, Kind, Mode, Reason, WatchdogState
from tests.hil.bed import Opened, SpiTestbed, Transfer
from tests.hil.wire import (
    LAST_STOP_3,
    LATE_S,
    SET_3,
    START_3,
    STOPS,
    Replay,
    Wire,
    opening_of,
    settings_for,
    start,
    transfers_of,
)
from tests.support.gateway_process import COMMAND, Gateway, write_settings
from tests.support.heard import Heard, events, states

pytestmark = pytest.mark.hil

FIRST_TRY_S = 0.1
LAST_TRIES_S = 2.0
BUSY_S = 0.5
"""What a busy machine may add to the two above, which are the contract's."""


class Scene:
    """Leg 3 runs; leg 4 waits to be started, for its start would come two seconds after leg 3's."""

    def __init__(self, gateway: Gateway, client: Client, wire: Wire, pool: ThreadPoolExecutor) -> None:
        self.gateway = gateway
        self.client = client
        self.wire = wire
        self.heard: Heard[Event] = events(client)
        seen = states(client)
        assert client.start_leg(3, 90, 45, 120).accepted
        wire.expect(START_3)
        self._waiting: Future[Ack] = pool.submit(client.start_leg, 4, 5, 6, 7)
        seen.wait(lambda state: state.legs[3].watchdog is WatchdogState.ARMED)

    def touch(self) -> None:
        """A Set for the running leg, whose frame meets the fault that was ordered; so does what waits."""
        rejected = self.client.set_leg(3, 91, 45, 120)
        assert (rejected.accepted, rejected.reason) == (False, Reason.BUS_FAULT)
        assert self._waiting.result(LATE_S).reason is Reason.BUS_FAULT

    def recovered(self, *, mode: Mode = Mode.IDLE) -> list[Transfer]:
        """Wait for it; all transfers since the fault. Nothing was delivered but Stops, among them all six at once."""
        self.heard.wait(lambda event: event.kind is Kind.BUS_RECOVERED, timeout_s=LATE_S)
        assert self.client.state().mode is mode
        kinds = [event.kind for event in self.heard.all if event.kind in (Kind.BUS_FAULT, Kind.BUS_RECOVERED)]
        assert kinds == [Kind.BUS_FAULT, Kind.BUS_RECOVERED]
        transfers = self.wire.skip()
        nothing_else = {*opening_of(self.wire.framing, *STOPS)}
        assert {each.data for each in transfers if each.delivered} <= nothing_else
        last = [each.data for each in transfers if each.opening == transfers[-1].opening and each.delivered]
        all_six = opening_of(self.wire.framing, *STOPS)
        assert any(last[begin : begin + len(all_six)] == all_six for begin in range(len(last)))
        return transfers

    def goes_on(self) -> None:
        """Nothing moves by itself, and all can be had again."""
        assert self.client.set_leg(3, 91, 45, 120).reason is Reason.SERVO_STOPPED
        self.wire.expect_nothing()
        assert self.client.start_leg(3, 90, 45, 120).accepted
        self.wire.expect_behind_rest(START_3)  # up to two seconds behind the Stops
        assert self.client.stop(3).accepted
        self.wire.expect(STOPS[2])


@contextmanager
def scene(folder: Path, wire: Wire, **sections: dict[str, Any]) -> Iterator[Scene]:
    sections = {"limits": {"start_stagger_ms": 2000}, **sections}
    with (
        start(folder, wire, **sections) as gateway,
        gateway.client() as client,
        ThreadPoolExecutor(1) as pool,
    ):
        yield Scene(gateway, client, wire, pool)


def openings(bed: SpiTestbed, since_ns: int) -> list[Opened]:
    return [event for event in bed.events if isinstance(event, Opened) and event.monotonic_ns > since_ns]


def check_tries(bed: SpiTestbed, fault_ns: int) -> list[float]:
    """The pauses before each try to reopen, in seconds."""
    times_ns = [fault_ns, *(opened.monotonic_ns for opened in openings(bed, fault_ns))]
    pauses_s = [(after - before) / 1e9 for before, after in pairwise(times_ns)]
    assert pauses_s[0] < FIRST_TRY_S + BUSY_S
    *others_s, _ = sorted(pauses_s)  # one may be longer where the bed itself waits for a processor
    assert max(others_s, default=0) < LAST_TRIES_S + BUSY_S
    return pauses_s


# ---- transfers fail


@pytest.mark.parametrize("count", [1, 10])
def test_transfers_that_fail_once_and_ten_times(tmp_path: Path, wire: Wire, count: int) -> None:
    with scene(tmp_path, wire) as at:
        wire.bed.fail(errno.EIO, count=count)
        at.touch()
        transfers = at.recovered()
        assert [each.errno for each in transfers if each.errno] == [errno.EIO] * count
        assert transfers[0].errno == errno.EIO
        check_tries(wire.bed, transfers[0].monotonic_ns)
        assert at.client.state().spi.errors > 0
        at.goes_on()


@pytest.mark.parametrize("batch", [True, False])
def test_a_short_write_is_a_fault_like_any_other(tmp_path: Path, wire: Wire, batch: bool) -> None:
    """The kernel states how many bytes it wrote, of a list as of a single transfer."""
    with scene(tmp_path, wire, spi={"batch": batch}) as at:
        wire.bed.shorten(count=1)
        at.touch()
        half = transfers_of(wire.framing, SET_3)[0]
        wire.expect_transfers([half[: len(half) // 2]])
        at.recovered()
        detail = next(event.detail for event in at.heard.all if event.kind is Kind.BUS_FAULT)
        assert "bytes were written" in detail
        at.goes_on()
        assert at.gateway.child.returncode is None


# ---- the device goes and comes back


def test_the_device_vanishes_and_comes_back(tmp_path: Path, wire: Wire) -> None:
    with scene(tmp_path, wire, log={"level": "debug"}) as at:
        wire.bed.remove_node()
        at.touch()
        at.gateway.child.wait_for_output("does not answer yet")
        assert at.client.start_leg(3, 5, 6, 7).reason is Reason.BUS_FAULT
        wire.bed.restore_node()
        transfers = at.recovered()
        assert transfers[0].errno == errno.ESHUTDOWN
        at.goes_on()


# ---- the emergency stop


def test_an_emergency_stop_during_a_fault_is_latched_and_sent_once_the_device_is_back(
    tmp_path: Path, wire: Wire
) -> None:
    with scene(tmp_path, wire) as at:
        wire.bed.remove_node()
        at.touch()
        engaged = at.client.estop()
        assert (engaged.accepted, engaged.stop_frames) == (True, 0)
        told = at.heard.wait(lambda event: event.kind is Kind.ESTOP_ENGAGED)
        assert "the SPI bus does not answer" in told.detail
        assert at.client.reset().reason is Reason.BUS_FAULT
        wire.bed.restore_node()
        at.recovered(mode=Mode.ESTOPPED)
        still_latched(at.client, wire)


def still_latched(client: Client, wire: Wire) -> None:
    assert client.start_leg(3, 90, 45, 120).reason is Reason.ESTOPPED
    wire.expect_nothing()
    assert client.reset().accepted
    assert client.start_leg(3, 90, 45, 120).accepted
    wire.expect_behind_rest(START_3)


# ---- the end


def test_an_end_while_the_device_is_away_is_in_time_and_says_what_was_not_done(
    tmp_path: Path, spi_testbed: SpiTestbed
) -> None:
    with scene(tmp_path, Wire(spi_testbed)) as at:
        spi_testbed.remove_node()
        at.touch()
        begun_s = time.monotonic()
        at.gateway.child.send_signal(signal.SIGTERM)
        assert at.gateway.child.wait(LATE_S) == 0
        assert time.monotonic() - begun_s < 1 + BUSY_S
        assert "no Stop can be sent" in at.gateway.child.stderr


@pytest.mark.parametrize("short", [False, True], ids=["EIO", "short writes"])
def test_the_last_attempt_outlasts_a_fault_that_begins_with_it(tmp_path: Path, wire: Wire, short: bool) -> None:
    """Each leg meets the fault by itself, and again: as long as there is time, all six are tried."""
    with start(tmp_path, wire) as gateway, gateway.client() as client:
        assert client.start_leg(3, 90, 45, 120).accepted
        wire.expect(START_3)
        wire.bed.shorten(count=20) if short else wire.bed.fail(count=20)
        gateway.child.terminate()
        assert gateway.child.wait(LATE_S) == 0, str(gateway.child)
        assert "at the last attempt" in gateway.child.stderr
        replay = Replay(wire.framing)
        replay.play(wire.bed.transfers)
        assert replay.energised_for_good() == frozenset()
        assert [each.data.hex() for each in wire.skip() if len(each.data) == 14][-6:] == STOPS


# ---- slow transfers


def test_transfers_of_300_ms_delay_a_stop_and_lose_none(tmp_path: Path, wire: Wire) -> None:
    with start(tmp_path, wire, watchdog={"repeats": 0, "timeout_ms": 250}) as gateway, gateway.client() as client:
        heard = events(client)
        wire.bed.delay_ms(300)
        assert client.start_leg(3, 90, 45, 120).accepted
        wire.expect(START_3, *LAST_STOP_3)
        assert heard.wait(lambda event: event.kind is Kind.WATCHDOG_EXPIRED)
        stopped = client.ask(keys.ESTOP, {})  # once: `estop` would ask again before it is answered
        assert (stopped.accepted, stopped.stop_frames) == (True, 6)
        wire.expect(*STOPS)
        assert client.estop().accepted
        wire.bed.delay_ms(0)
        assert client.ask(keys.ESTOP, {}).accepted  # once, and behind all that `estop` had asked
        assert {each.data for each in wire.skip()} <= set(opening_of(wire.framing, *STOPS))
        assert client.reset().accepted
        assert client.set_leg(3, 91, 45, 120).reason is Reason.SERVO_STOPPED
        wire.expect_nothing()
        assert Kind.BUS_FAULT not in {event.kind for event in heard.all}
        assert client.start_leg(3, 90, 45, 120).accepted
        wire.expect_behind_rest(START_3)


# ---- stop-servos


def test_stop_servos_says_what_failed(tmp_path: Path, wire: Wire) -> None:
    wire.bed.fail(errno.EIO)
    config = write_settings(tmp_path / "gateway.toml", settings_for(wire))
    child = wire.bed.spawn([*COMMAND, "stop-servos", "--config", str(config)])
    assert child.wait(LATE_S) == 3
    assert child.stderr == "hexapod-gateway: /dev/spidev0.0: the transfer failed: Input/output error\n"
    assert child.stdout == ""


# ---- lists of transfers


NO_CHIP_SELECT = """
import spidev
spi = spidev.SpiDev()
spi.open(0, 0)
spi.mode = 3
spi.no_cs = True
"""


def test_a_mode_that_another_program_has_left_behind_is_cleared(tmp_path: Path, wire: Wire) -> None:
    assert wire.bed.spawn([sys.executable, "-c", NO_CHIP_SELECT]).wait(LATE_S) == 0
    assert [setting.value for setting in wire.bed.settings if setting.kind == "mode"][-1] == 0x43
    with start(tmp_path, wire):
        assert {each.mode for each in wire.bed.transfers} == {0}


@pytest.mark.parametrize("code", [errno.EINVAL, errno.EMSGSIZE])
def test_a_kernel_that_rejects_lists_gets_one_call_each_and_no_stop_is_lost(
    tmp_path: Path, wire: Wire, code: int
) -> None:
    wire.bed.reject_lists(code)
    with Gateway(tmp_path, settings_for(wire), bed=wire.bed) as gateway, gateway.client() as client:
        assert wire.bed.transfers[0].errno == code
        transfers = [each for each in wire.skip() if each.delivered]
        assert [each.data for each in transfers] == opening_of(wire.framing, *STOPS)
        assert len({each.call for each in transfers}) == len(transfers)
        assert client.start_leg(3, 90, 45, 120).accepted
        wire.expect(START_3)
        gateway.child.wait_for_output("the kernel rejects a list")
        assert gateway.child.stderr.count("the kernel rejects a list") == 1


def test_a_device_that_vanishes_within_a_list(tmp_path: Path, wire: Wire) -> None:
    with scene(tmp_path, wire) as at:
        wire.bed.fail(errno.ESHUTDOWN, after=3)
        stopped = at.client.ask(keys.ESTOP, {})
        assert (stopped.accepted, stopped.stop_frames) == (True, 0)
        wire.bed.remove_node()
        wire.bed.heal()
        wire.bed.restore_node()
        at.recovered(mode=Mode.ESTOPPED)


def test_a_buffer_of_the_kernel_that_is_smaller_than_its_default(tmp_path: Path, spi_testbed: SpiTestbed) -> None:
    """Twenty transfers of 128 bytes: the preamble and six Stops are rejected as one list, and lose nothing."""
    wire = Wire(spi_testbed, Framing.LENGTH_PREFIXED)
    spi_testbed.set_bufsiz(20 * 128)
    with Gateway(tmp_path, settings_for(wire), bed=spi_testbed):
        assert [each.data for each in spi_testbed.transfers if not each.errno] == opening_of(wire.framing, *STOPS)
