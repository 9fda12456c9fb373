"""Without batches, the service is stopped (SIGSTOP) between an announcement and its body, for longer than the
controller waits. With batches there is no such moment.

What it wrote is given to a simulated controller, which reads it as the published firmware does, at the same times.
"""

import signal
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from gateway.client import Client, leg_payload
from gateway.model.frames import stop_leg
from gateway.model.framing import ZERO, Framing
from schemas import keys
from schemas.robot import LEGS
from tests.hil.bed import SpiTestbed
from tests.hil.wire import LATE_S, Replay, Wire, start

pytestmark = pytest.mark.hil

STALL_S = 1.2
LEGS_START = {"legs": {str(leg): leg_payload("start", (90, 90, 90)) for leg in range(1, 7)}}
FREEZE_MS = 300
"""How long the announcement takes: time to stop the service within it."""


@pytest.mark.parametrize("repeats", [0, 3])
def test_a_service_that_stood_still_in_the_middle_of_a_frame_still_stops_the_robot(
    tmp_path: Path, spi_testbed: SpiTestbed, repeats: int
) -> None:
    wire = Wire(spi_testbed, Framing.LENGTH_PREFIXED)
    watchdog = {"timeout_ms": 10_000, "repeats": repeats}
    limits = {"max_age_ms": 0}  # a busy machine may hold the service for so long that what it then reads is rejected
    with (
        start(tmp_path, wire, watchdog=watchdog, limits=limits, spi={"batch": False}) as gateway,
        gateway.client() as client,
    ):
        assert client.ask(keys.LEGS_COMMAND, LEGS_START).accepted
        if repeats:
            time.sleep(0.2)  # until nothing is repeated any more, and the next announcement is the set's
        before = len(spi_testbed.transfers)
        spi_testbed.delay_ms(FREEZE_MS)
        with ThreadPoolExecutor(1) as pool:
            pool.submit(set_leg_3, client)
            announcement = spi_testbed.wait_for_data(b"\x0e", since=before, timeout_s=LATE_S)
            gateway.child.send_signal(signal.SIGSTOP)
            spi_testbed.delay_ms(0)
            time.sleep(STALL_S)  # the stall itself
            gateway.child.send_signal(signal.SIGCONT)
            stopped = client.estop()
        assert (stopped.accepted, stopped.stop_frames) == (True, 6)
        transfers = spi_testbed.transfers
    behind = [each.data for each in transfers[before:]]
    assert behind[0] == announcement.data
    stop = next(place for place, data in enumerate(behind) if data in {stop_leg(leg).to_bytes() for leg in LEGS})
    assert set(behind[1 : stop - 1]) <= {ZERO}, "in place of the body, which is too late"
    replay = Replay(wire.framing)
    replay.play(transfers[:before])
    assert len(replay.controller.energised) == 18
    replay.play(transfers[before:])
    assert replay.controller.energised == frozenset()
    assert replay.controller.executed == sum(len(each.data) > 1 for each in transfers)


def set_leg_3(client: Client) -> None:
    client.publish(keys.leg_command(3), leg_payload("set", (91, 45, 120)))
