"""What the fuzzers start from: good and nearly good inputs."""

import json
from pathlib import Path
from typing import Any

from schemas import keys
from schemas.command import MAX_PAYLOAD_BYTES
from tests.fuzz.targets import KEYS, PAUSES_NS

VECTORS: dict[str, list[dict[str, Any]]] = json.loads((Path(__file__).parents[1] / "data" / "frames.json").read_text())

MOVE = {"op": "start", "angle_deg": 90.25}
STOP = {"op": "stop"}
LEG = {"servos": [MOVE, STOP, {"op": "set", "angle_deg": 180}]}
SENDER = {"source": "fuzz", "sent_ms": 1234.5}
PAYLOADS: tuple[tuple[str, object], ...] = (
    (keys.servo_command(32), MOVE),
    (keys.servo_command(11), STOP | SENDER),
    (keys.leg_command(1), LEG | SENDER),
    (keys.leg_command(6), {"servos": [MOVE] * 4}),
    (keys.LEGS_COMMAND, {"legs": {str(leg): LEG for leg in range(1, 7)}} | SENDER),
    (keys.LEGS_COMMAND, {"legs": {"7": LEG}}),
    (keys.RESET, {}),
    (keys.RESET, {"estop": 3} | SENDER),
    (keys.ESTOP, {"any": ["thing"]}),
)


def seeds(target: str) -> list[bytes]:
    """The inputs that the fuzzer of `target` starts from."""
    if target == "intake":
        index_of = {known: KEYS.index(parsed) for known, parsed in keys.COMMAND_KEYS.items()}
        good = [bytes((index_of[key], 0)) + json.dumps(payload).encode() for key, payload in PAYLOADS]
        sizes = [bytes((0, 0)) + b" " * size for size in (MAX_PAYLOAD_BYTES, MAX_PAYLOAD_BYTES + 1)]
        return [*good, *sizes, bytes((0, 3)), bytes((index_of[keys.RESET], 1))]
    frames = [bytes.fromhex(vector["bytes"]) for vector in VECTORS["legal"] + VECTORS["illegal"]]
    if target == "decode":
        return [b"\0" + frame for frame in frames] + [b"\1" + frame.hex(" ").encode() for frame in frames]
    apart = PAUSES_NS.index(1_000_000)
    plain = [bytes((apart, len(frame))) + frame for frame in frames if frame]
    announced = [bytes((apart, 1, len(frame), apart, len(frame))) + frame for frame in frames if frame]
    begun, said = frames[0][:5], bytes((apart, 1, len(frames[0])))
    return [
        *(b"\0" + frame for frame in plain),
        *(b"\1" + frame for frame in announced),
        # One frame begun, and the next one after each of the pauses.
        *(b"\0" + bytes((apart, 5)) + begun + bytes((pause, 0)) + plain[1] for pause in range(len(PAUSES_NS))),
        *(
            b"\1" + said + bytes((apart, 5)) + begun + bytes((pause, 0)) + announced[1]
            for pause in range(len(PAUSES_NS))
        ),
        b"\0" + b"".join(plain[:5]),
        b"\1" + b"".join(announced[:5]),
    ]
