"""Stops as other programs write them, none of which is a valid command: the payload, and its encoding."""

import base64
import gzip
import json
from collections.abc import Callable
from typing import Any, Final, NamedTuple

from schemas.command import MAX_PAYLOAD_BYTES
from schemas.telemetry import Reason

JSON: Final = "application/json"


class Form(NamedTuple):
    """A payload that may contain a Stop, and why it is rejected."""

    payload: bytes
    reason: Reason
    encoding: str = JSON


def _text(value: Any, **how: Any) -> bytes:
    return json.dumps(value, **how).encode()


def _forms(setpoint: Callable[..., dict[str, Any]]) -> dict[str, Form]:
    """Return the forms of a command that stops. `setpoint(stop, **more)` makes it with this Stop for each servo."""
    plain = _text(setpoint({"op": "stop"}))
    bare = plain.decode()
    invalid = {
        "null angle": setpoint({"op": "stop", "angle_deg": None}),
        "zero angle": setpoint({"op": "stop", "angle_deg": 0}),
        "angle": setpoint({"op": "stop", "angle_deg": 90.0}),
        "upper case": setpoint({"op": "STOP"}),
        "title case": setpoint({"op": "Stop"}),
        "space": setpoint({"op": "stop "}),
        "enum": setpoint({"op": "OP_STOP"}),
        "unknown field": setpoint({"op": "stop"}, comment="x"),
        "unknown field of a servo": setpoint({"op": "stop", "speed": 0}),
        "long source": setpoint({"op": "stop"}, source="x" * 70),
        "empty source": setpoint({"op": "stop"}, source=""),
        "sent_ms as a string": setpoint({"op": "stop"}, sent_ms="12"),
        "sent_ms below 0": setpoint({"op": "stop"}, sent_ms=-1),
        "wrong lease": setpoint({"op": "stop"}, lease="none"),
        "list": [setpoint({"op": "stop"})],
        "envelope": {"command": setpoint({"op": "stop"})},
        "many fields": setpoint({"op": "stop"}, **{f"x{number}": 0 for number in range(300)}),
    }
    made = {name: Form(_text(value), Reason.INVALID) for name, value in invalid.items()}
    malformed = {
        "NUL behind it": plain + b"\0",
        "byte order mark": b"\xef\xbb\xbf" + plain,
        "UTF-16": bare.encode("utf-16"),
        "UTF-16 without a mark": bare.encode("utf-16-be"),
        "UTF-16 that begins like JSON": bare.encode("utf-16-le"),
        "UTF-32": bare.encode("utf-32"),
        "single quotes": bare.replace('"', "'").encode(),
        "comma at the end": plain[:-1] + b",}",
        "cut off": plain[:-1],
        "word": b"stop",
        "gzip": gzip.compress(plain, mtime=0),
        "base64": base64.b64encode(plain),
        "deep": b'{"x":' + b"[" * 2000 + plain,
    }
    made |= {name: Form(payload, Reason.MALFORMED) for name, payload in malformed.items()}
    twice = bare.replace('"op": "stop"', '"op": "stop", "op": "start", "angle_deg": 9').encode()
    made["given twice"] = Form(twice, Reason.INVALID)
    upper = plain.upper().replace(b'"OP"', b'"op"').replace(b'"SERVOS"', b'"servos"').replace(b'"LEGS"', b'"legs"')
    made["escaped"] = Form(upper.replace(b"STOP", b"\\u0053TOP"), Reason.INVALID)
    made |= {
        encoding: Form(plain, Reason.BAD_ENCODING, encoding)
        for encoding in ("text/plain", "application/octet-stream", "text/json", "application/cbor", "APPLICATION/JSON")
    }
    too_large = b" " * (MAX_PAYLOAD_BYTES + 1 - len(plain)) + plain
    made["too large"] = Form(too_large, Reason.TOO_LARGE)
    made["not plain, and in a foreign encoding"] = Form(_text(invalid["null angle"]), Reason.BAD_ENCODING, "text/plain")
    return made


def _of_leg(stop: Any, **more: Any) -> dict[str, Any]:
    return {"servos": [stop] * 3, **more}


def _of_legs(stop: Any, **more: Any) -> dict[str, Any]:
    return {"legs": {"3": _of_leg(stop)}, **more}


def _of_servo(stop: Any, **more: Any) -> dict[str, Any]:
    return {**stop, **more}


FORMS: Final = {
    f"{key}: {name}": (key, form)
    for key, setpoint in (
        ("hexapod/leg/3/cmd", _of_leg), ("hexapod/servo/32/cmd", _of_servo), ("hexapod/legs/cmd", _of_legs)
    )
    for name, form in _forms(setpoint).items()
}  # fmt: skip
"""By name: the key, and the form of a Stop for servo 32 among others."""
