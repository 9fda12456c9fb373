"""The gateway dies, in the middle of anything: `stop-servos` leaves 18 Stops, and a controller with no servo on.

What the dead gateway and `stop-servos` wrote to the emulated device is given to a simulated controller, which reads it
as the published firmware does, at the times at which it came.
"""

import os
import random
import signal
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from gateway.model.black_box import RING_FILE
from gateway.model.frames import Frame, Framing, OneLeg, OneServo, Op, ServoOp, decode
from gateway.people.incidents import ring_reader as rec
from schemas.robot import LEGS
from schemas.words import Cause
from tests.benchmarks.processes import publishing
from tests.hil.bed import SpiTestbed, Transfer
from tests.hil.wire import EACH_FRAMING, STOPS, Replay, Wire, ended, moving, opening_of, settings_for
from tests.support.controllers import on_wire
from tests.support.gateway_process import COMMAND, dialling, free_port, write_settings

pytestmark = [pytest.mark.hil, pytest.mark.alone]

MS = 1_000_000
ROUNDS = 4  # of stop-servos: one, and three repeats


def stop_servos(bed: SpiTestbed, config: Path) -> list[Transfer]:
    """Run it to its end, and return what it wrote. Others' writes may be reported only now, as other openings."""
    earlier = newest_opening(bed)
    ended(bed, "stop-servos", config)
    return [each for each in bed.transfers if each.opening > earlier]


def newest_opening(bed: SpiTestbed) -> int:
    return max((each.opening for each in bed.transfers), default=0)


def check_stops(framing: Framing, replay: Replay, stops: list[Transfer]) -> None:
    """Check that 18 Stops came four times, and that each time is enough for a controller anywhere in a frame."""
    one_round = opening_of(framing, *STOPS)
    assert [each.data for each in stops] == one_round * ROUNDS
    replay.play(stops[: len(one_round)])
    assert replay.controller.energised == frozenset()
    replay.play(stops[len(one_round) :])
    assert replay.energised_for_good() == frozenset()
    assert not replay.controller.corruptions


# ---- killed under load


KILLS = int(os.environ.get("KILLS", "12"))  # for each framing; KILLS=200 takes some minutes
LANES = 3  # gateways that share nothing, at once


def loaded(framing: Framing, endpoint: str, folder: Path) -> dict[str, dict[str, Any]]:
    """Return settings of a gateway that dials the publisher, and has more to send than the link carries."""
    return {
        # Announced, half of the time is between an announcement and its body, within one call.
        "spi": {"framing": framing, "frame_gap_us": 1000 if framing is Framing.LENGTH_PREFIXED else 100},
        "limits": {"leg_rate_hz": 100},
        # On a busy machine the publisher pauses for longer than the default, and the legs would stop before the kill.
        "watchdog": {"timeout_ms": 10_000},
        "zenoh": {"listen": [f"tcp/127.0.0.1:{free_port()}"], "config": dialling(folder, endpoint)},
        "state": {"path": str(folder / "box")},
    }


def kill_once(bed: SpiTestbed, framing: Framing, config: Path, moment_s: float) -> bool:
    """Kill a gateway that long after its first start, and run stop-servos. Return whether half a frame was written."""
    earlier = newest_opening(bed)
    gateway = bed.spawn([*COMMAND, "run", "--config", str(config)])
    bed.wait_for(lambda transfers: any(moves(each) for each in transfers if each.opening > earlier), 60)
    time.sleep(moment_s)  # the moment itself; nothing is waited for
    gateway.close()
    assert gateway.returncode == -signal.SIGKILL
    stops = stop_servos(bed, config)
    of_gateway = [each for each in bed.transfers if each.opening == earlier + 2]  # behind its very first Stops
    check_black_box(config.parent / "box" / RING_FILE, of_gateway)
    replay = Replay(framing).play(of_gateway)
    first_move = next(place for place, each in enumerate(of_gateway) if moves(each))
    stopped_again = any(each.data.hex() in STOPS for each in of_gateway[first_move:])  # see check_black_box
    assert replay.controller.energised or stopped_again
    check_stops(framing, replay, stops)
    return len(of_gateway[-1].data) == 1


def check_black_box(ring: Path, transfers: list[Transfer]) -> None:
    """Check that the black box has what the dead gateway wrote to the wire, in order.

    The frames of the last batch may be missing, which with long pauses is several calls: the process was killed between
    these and their records. No record stands for a frame that was not written, and each frame that moves stands behind
    its command.
    """
    content = rec.read(ring)
    assert not content.written
    starts = [index for index, record in enumerate(content) if isinstance(record.content, rec.Start)]
    records = list(content)[starts[-1] :]
    frames = [record.content for record in records if isinstance(record.content, rec.FrameWritten)]
    delivered = [each for each in transfers if each.delivered and len(each.data) in (6, 14)]
    assert [frame.data for frame in frames] == [each.data for each in delivered[: len(frames)]]
    lost = delivered[len(frames) :]
    legs = [each.data[2] // 10 for each in lost]
    assert len(set(legs)) == len(legs), "a batch has one frame for each leg at most"
    commands = [record.content for record in records if isinstance(record.content, rec.CommandRecord)]
    commanded = {tuple(op.angle_cdeg for _, op in command.targets) for command in commands}
    for frame in frames:
        # Where a busy machine let a ring run full, a Stop may have been lost, and the gateway writes one of its own.
        if frame.cause == Cause.COMMAND and frame.data.hex() not in STOPS:
            assert tuple(op.angle_cdeg for _, op in decode(frame.data).servos) in commanded


def moves(transfer: Transfer) -> bool:
    return len(transfer.data) == 14 and transfer.data.hex() not in STOPS


@pytest.mark.parametrize("framing", Framing)
def test_killed_at_random_moments_under_load(tmp_path: Path, framing: Framing, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))  # for the black boxes
    seed = int(os.environ.get("KILL_SEED", time.time_ns() % 1_000_000))
    print(f"KILL_SEED={seed}")
    chance = random.Random(seed)  # noqa: S311  (moments, no secrets)
    moments_s = [chance.uniform(0, 0.1) for _ in range(KILLS)]

    def lane(number: int) -> int:
        folder = tmp_path / str(number)
        folder.mkdir()
        config = write_settings(folder / "gateway.toml", loaded(framing, endpoint, folder))
        with SpiTestbed() as bed:
            return sum(kill_once(bed, framing, config, at_s) for at_s in moments_s[number::LANES])

    endpoint = f"tcp/127.0.0.1:{free_port()}"
    load = publishing(endpoint, "--listen", "--legs", *map(str, LEGS), "--hz", "100")
    with load, ThreadPoolExecutor(LANES) as pool:
        within_frames = sum(pool.map(lane, range(LANES)))
    assert within_frames == 0, "an announcement and its body leave together"


# ---- every cut, without chance


STARTS: list[Frame] = [
    OneServo(11, ServoOp(Op.START, 0)),
    OneServo(63, ServoOp(Op.START, 180_00)),
    OneServo(32, ServoOp(Op.SET, 6_14)),
    OneLeg(1, (ServoOp(Op.START, 90_29),) * 3),
    OneLeg(6, (ServoOp(Op.START, 14_06), ServoOp(Op.STOP, 0), ServoOp(Op.SET, 6_14))),
]
LAGS_NS = (0, 1 * MS, 500 * MS, 999 * MS, 1000 * MS, 1001 * MS, 5000 * MS)
"""From the death to stop-servos: around the second after which the controller gives a receive up."""


def cuts(framing: Framing) -> Iterator[list[bytes]]:
    """Yield all that a kernel can have transferred of two frames when their sender dies."""
    for first in STARTS:
        for second in STARTS:
            transfers = on_wire(framing, first, second)
            for length in range(len(transfers) + 1):
                yield transfers[:length]


def later(transfers: list[Transfer], begin_ns: int) -> list[Transfer]:
    """Return the same as if the first had come at `begin_ns`."""
    moved_ns = begin_ns - transfers[0].monotonic_ns
    return [replace(each, monotonic_ns=each.monotonic_ns + moved_ns) for each in transfers]


@EACH_FRAMING
def test_wherever_it_died_stop_servos_leaves_no_servo_on(tmp_path: Path, wire: Wire) -> None:
    last_resort = stop_servos(wire.bed, write_settings(tmp_path / "gateway.toml", settings_for(wire)))
    for cut in cuts(wire.framing):
        for lag_ns in LAGS_NS:
            replay = moving(wire.framing)
            for data in cut:
                replay.give(data, 1 * MS)
            check_stops(wire.framing, replay, later(last_resort, 1 * MS + lag_ns))
