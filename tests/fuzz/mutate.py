"""Changes to inputs: to their bytes; and to a command such that it stays JSON, since bytes alone seldom get past the
parser, to where fields are looked at."""

import json
import random
from typing import Any

NUMBERS = (0, 1, 90.005, 179.995, 180, 180.01, -0.0, -1e-9, 1e-400, 1e308, 2**53, 2**53 + 2, 10**400, float("nan"), -1)
WORDS = ("start", "set", "stop", "", "x" * 64, "x" * 65, "ä\n\x1b[31m", "\ud800", "1", "0", "angle_deg")
NAMES = ("op", "angle_deg", "servos", "legs", "source", "sent_ms", "1", "6", "7", "[key]", "start", "a\nb", "k" * 90)


PIECES = (
    *(b'"op"', b'"stop"', b'"start"', b'"servos"', b'"legs"', b'"estop"', b'"sent_ms"', b'{"op":"stop"}'),
    *(b"{", b"[", b",", b"null", b"NaN", b"-Infinity", b"1e999", b'"\\ud800"', "\ufeff".encode()),
    *(b"0x", b"06 02", b"0e01", b"\0\x01", b"\xff"),
)


def mutate(data: bytes, chance: random.Random) -> bytes:
    """`data` with some of its bytes replaced, left out, doubled, or with a piece put in."""
    for _ in range(chance.choice((1, 1, 2, 4))):
        at, end = sorted(chance.randrange(len(data) + 1) for _ in range(2))
        end = min(end, at + chance.choice((1, 1, 2, 4, 40)))
        middle = chance.choice((chance.randbytes(end - at), b"", 2 * data[at:end], chance.choice(PIECES)))
        data = data[:at] + middle + data[end:]
    return data


class Pairs(list[tuple[str, Any]]):
    """An object as its (name, value) pairs, so that a name may come twice."""


def mutate_json(payload: bytes, chance: random.Random) -> bytes | None:
    """`payload` with one or some of its values, names or entries changed; None if it is no JSON."""
    try:
        document = json.loads(payload, object_pairs_hook=Pairs)
    except (ValueError, RecursionError):
        return None
    for _ in range(chance.choice((1, 1, 1, 2, 4))):
        document = _changed(document, chance)
    return _text(document).encode(errors="surrogatepass")


def _changed(value: Any, chance: random.Random) -> Any:
    if isinstance(value, list) and value and chance.random() < 0.8:
        index = chance.randrange(len(value))
        return _with_entry_changed(value, index, chance)
    return _something(value, chance)


def _with_entry_changed(value: list[Any], index: int, chance: random.Random) -> list[Any]:
    made = type(value)(value)
    what = chance.random()
    if what < 0.08:
        del made[index]
    elif what < 0.16:
        made.append(made[index])
    elif isinstance(made, Pairs):
        name, inner = made[index]
        made[index] = (chance.choice(NAMES), inner) if what < 0.3 else (name, _changed(inner, chance))
    else:
        made[index] = _changed(made[index], chance)
    return made


def _something(value: Any, chance: random.Random) -> Any:
    choices: list[Any] = [chance.choice(NUMBERS), chance.uniform(0, 180), chance.choice(WORDS), None, True, [], Pairs()]
    choices += [[value], Pairs([(chance.choice(NAMES), value)])]
    if isinstance(value, str):
        choices += [chance.choice(WORDS)] * 6
    if isinstance(value, Pairs):
        choices += [Pairs([*value, (chance.choice(NAMES), chance.choice(NUMBERS))])] * 6
    if isinstance(value, float | int):
        choices += [chance.choice(NUMBERS)] * 3 + [chance.uniform(-1, 181)] * 6
    return chance.choice(choices)


def _text(value: Any) -> str:
    if isinstance(value, Pairs):
        return "{" + ",".join(f"{json.dumps(name)}:{_text(inner)}" for name, inner in value) + "}"
    if isinstance(value, list):
        return "[" + ",".join(map(_text, value)) + "]"
    return json.dumps(value)
