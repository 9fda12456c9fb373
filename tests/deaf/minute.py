"""A minute of commands, as laptops would send them: walking, single servos, slow streams, silence, emergency stops."""

import json
import math
import random
from collections.abc import Iterator
from typing import Any, NamedTuple

from schemas import keys
from schemas.robot import LEGS

SEED = 8


class Message(NamedTuple):
    at_ms: float
    key: str
    payload: bytes


def minute() -> list[Message]:
    """Return the same messages each time, in order."""
    chance = random.Random(SEED)  # noqa: S311  (angles, no secrets)
    found = [*_walk(2_000, 14_000, 50), _put(14_000, keys.ESTOP, {}), _put(16_200, keys.RESET, {})]
    found += _three_legs(16_500, 24_000, chance)  # then silence: the watchdog's
    found += _slow(25_000, 40_000)
    found += _mixed(40_000, 52_000, chance)
    found += [_put(at_ms, keys.ESTOP, {}) for at_ms in (52_000, 52_100, 52_250)]
    found += [_put(54_500, keys.RESET, {}), *_walk(55_000, 59_000, 50)]
    found += [_put(59_010 + leg, keys.leg_command(leg), {"servos": [{"op": "stop"}] * 3}) for leg in LEGS]
    return sorted(found, key=lambda message: message.at_ms)


def stopped_walk(stop_ms: int) -> list[Message]:
    """Return six legs at 50 Hz, and an emergency stop."""
    return [*_walk(500, stop_ms, 20), _put(stop_ms, keys.ESTOP, {})]


def _put(at_ms: float, key: str, payload: dict[str, Any]) -> Message:
    return Message(at_ms, key, json.dumps(payload).encode())


def _angles(leg: int, at_ms: float) -> list[float]:
    """Return a gait: each joint swings, to the hundredth of a degree, so that many values come on the wire."""
    phase = at_ms / 800 * 2 * math.pi + leg * math.pi / 3
    return [round(90 + swing * math.sin(phase + joint), 2) for joint, swing in enumerate((25.3, 40.7, 85.9))]


def _leg(op: str, leg: int, at_ms: float) -> dict[str, Any]:
    return {"servos": [{"op": op, "angle_deg": angle_deg} for angle_deg in _angles(leg, at_ms)]}


def _walk(begin_ms: int, end_ms: int, period_ms: int) -> Iterator[Message]:
    """Yield all legs in one message; a start now and then, as one who has missed a stop would send it."""
    for count, at_ms in enumerate(range(begin_ms, end_ms, period_ms)):
        op = "start" if count % 10 == 0 else "set"
        yield _put(at_ms, keys.LEGS_COMMAND, {"legs": {str(leg): _leg(op, leg, at_ms) for leg in LEGS}})


def _three_legs(begin_ms: int, end_ms: int, chance: random.Random) -> Iterator[Message]:
    """Yield three legs at 50 Hz, spread evenly, and single servos of a fourth."""
    for count, at_ms in enumerate(range(begin_ms, end_ms, 20)):
        for leg in (1, 2, 3):
            yield _put(at_ms + 6 * leg, keys.leg_command(leg), _leg("start" if count % 25 == 0 else "set", leg, at_ms))
        if count % 5 == 0:
            servo = chance.choice((41, 42, 43))
            op = chance.choice(("start", "start", "set", "stop"))
            more = {} if op == "stop" else {"angle_deg": round(chance.uniform(4, 180), 2)}
            yield _put(at_ms + 1, keys.servo_command(servo), {"op": op, **more})


def _slow(begin_ms: int, end_ms: int) -> Iterator[Message]:
    """Yield two legs at 8 Hz, one of them stopped and started again and again."""
    for count, at_ms in enumerate(range(begin_ms, end_ms, 125)):
        yield _put(at_ms, keys.leg_command(5), _leg("start" if count % 8 == 0 else "set", 5, at_ms))
        stop = {"servos": [{"op": "stop"}] * 3}
        yield _put(at_ms + 3, keys.leg_command(6), stop if count % 16 > 12 else _leg("start", 6, at_ms))


def _mixed(begin_ms: int, end_ms: int, chance: random.Random) -> Iterator[Message]:
    """Yield all legs at 10 Hz. One is stopped at any time, and started again, sometimes before its repeats."""
    for count, at_ms in enumerate(range(begin_ms, end_ms, 100)):
        op = "start" if count % 5 == 0 else "set"
        yield _put(at_ms, keys.LEGS_COMMAND, {"legs": {str(leg): _leg(op, leg, at_ms) for leg in LEGS}})
        if count % 4 == 0:
            leg, stop_ms = chance.choice(LEGS), at_ms + chance.uniform(0, 100)
            yield _put(stop_ms, keys.leg_command(leg), {"servos": [{"op": "stop"}] * 3})
            yield _put(stop_ms + chance.choice((5, 30, 70)), keys.leg_command(leg), _leg("start", leg, at_ms))
