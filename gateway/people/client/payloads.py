"""The payloads of commands, from any kind of number."""

import math
import operator
from collections.abc import Collection, Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final, Literal, Protocol, SupportsFloat, SupportsIndex, TypeGuard, cast

from gateway.errors import OutOfRangeError
from gateway.people.numbers import plain
from schemas.robot import JOINTS, LEGS, MAX_DEG, SERVO_IDS

if TYPE_CHECKING:
    from schemas.calibration import ServoChange

Angle = SupportsFloat | SupportsIndex
"""An int, a float, or a number such as numpy's `float32` and `int64`; no bool."""
Unit = Literal["deg", "rad"]
"""The unit of angles: degrees (0 to 180), or radians (0 to π)."""
ROUNDING_DEG: Final = 0.005
"""Half of the protocol's hundredth. An angle outside 0 to 180 by this much counts as the limit (a rounding error)."""

LegAngles = dict[int, tuple[float, ...]]
"""The three angles of each leg in degrees, by its number."""


class Array(Protocol):
    """numpy's arrays; lists and tuples of this shape are accepted as well."""

    def __len__(self) -> int: ...
    def __getitem__(self, index: int, /) -> Any: ...


Setpoints = Mapping[int, Sequence[Angle] | Array] | Array
"""Angles of joints 1, 2, 3 by the leg's number; or all six legs as an array of the shape (6, 3) or (18,)."""


def leg_payload(op: str, angles: Sequence[Angle] | Array = (), unit: Unit = "deg") -> dict[str, Any]:
    """Return the payload of a leg's command: one operation for three servos, and three angles unless it stops.

    Raises OutOfRangeError for other than three angles or an angle outside 0 to 180 degrees; TypeError if an angle is no
    number, or if they have no order.

    >>> leg_payload("set", (90, 45.5, 120))["servos"][1]
    {'op': 'set', 'angle_deg': 45.5}
    """
    return {"servos": [servo_payload(op)] * 3} if op == "stop" else _setpoint(op, _leg_angles(angles, unit))


def _leg_angles(angles: object, unit: Unit, leg: str = "") -> tuple[float, ...]:
    if not _is_row(angles):
        raise TypeError(f"a leg's angles are a list, a tuple or an array of three, and not {angles!r}")
    if len(angles) != len(JOINTS):
        raise OutOfRangeError(f"{leg}{len(angles)} angles; a leg has three joints")
    return tuple([number(angle, unit, leg, joint) for joint, angle in enumerate(angles, start=1)])


def _setpoint(op: str, angles: tuple[float, ...]) -> dict[str, Any]:
    return {"servos": [{"op": op, "angle_deg": angle} for angle in angles]}


def row(angles: tuple[Angle | Sequence[Angle] | Array, ...]) -> Sequence[Angle] | Array:
    """Return a leg's angles, which are given one by one or as one list, tuple or array.

    >>> row((90, 45, 120)), row(([90, 45, 120],))
    ((90, 45, 120), [90, 45, 120])
    """
    if len(angles) == 1 and _is_row(angles[0]):
        return angles[0]
    return cast(tuple[Angle, ...], angles)  # `number` checks each


def _is_row(value: object) -> TypeGuard[Sequence[Angle]]:
    """Return whether a value has an order of joints: a Sequence or a numpy array, but no set or dict."""
    if type(value) is tuple or type(value) is list:  # a stream's, usually; an ABC's check takes ten calls
        return True
    indexed = isinstance(value, Collection) and hasattr(value, "__getitem__")
    return indexed and not isinstance(value, str | bytes | Mapping)


def legs_payload(op: str, angles: Setpoints, unit: Unit = "deg") -> dict[str, Any]:
    """Return the payload of one command for several legs (1 to 6): one operation, three angles for each.

    Raises as `leg_payload` and `leg_number`.
    """
    if op == "stop":
        return {"legs": {str(leg_number(leg)): leg_payload(op) for leg in cast(Mapping[int, Any], angles)}}
    return {"legs": setpoints(op, legs_angles(angles, unit))}


def legs_angles(angles: Setpoints, unit: Unit = "deg") -> LegAngles:
    """Return the degrees of several legs (1 to 6). Raises as `leg_payload` and `leg_number`.

    >>> legs_angles([90, 45, 120] * 6) == legs_angles([(90, 45, 120)] * 6)
    True
    """
    if not isinstance(angles, Mapping):
        angles = dict(zip(LEGS, _rows(angles), strict=True))
    return {(n := leg_number(leg)): _leg_angles(each, unit, f"leg {n}, ") for leg, each in angles.items()}


def _rows(angles: object) -> Sequence[Any]:
    """Return the six legs of an array. Raises TypeError for anything else, OutOfRangeError for another shape."""
    if not _is_row(angles):
        raise TypeError(f"legs and their angles are a dict, such as {{3: (90, 45, 120)}}, or an array, not {angles!r}")
    count, shape = len(JOINTS), getattr(angles, "shape", None)
    if len(angles) == len(SERVO_IDS) and shape in (None, (len(SERVO_IDS),)):
        return [angles[at : at + count] for at in range(0, len(SERVO_IDS), count)]
    if len(angles) != len(LEGS) or shape not in (None, (len(LEGS), count)):
        raise OutOfRangeError(f"an array for all six legs has the shape (6, 3) or (18,), not {shape or len(angles)}")
    return cast(Sequence[Any], angles)


def setpoints(op: str, angles: LegAngles) -> dict[str, Any]:
    """Return the legs of a payload, from the result of `legs_angles`: a stream reads each angle once."""
    return {str(leg): _setpoint(op, each) for leg, each in angles.items()}


def servo_payload(op: str, angle: Angle | None = None) -> dict[str, Any]:
    """Return the payload of a servo's command. Raises as `number`."""
    return {"op": op} if angle is None else {"op": op, "angle_deg": number(angle)}


def calibration_payload(
    servos: "Mapping[int, ServoChange]" = MappingProxyType({}),
    landing: Mapping[int, Angle | None] = MappingProxyType({}),
    *,
    revision: int | None = None,
    accept_default: bool = False,
) -> dict[str, Any]:
    """Return the payload that changes the calibration; see `Client.calibrate`. Raises as `number`."""
    payload: dict[str, Any] = {
        "servos": {str(name): change.model_dump(exclude_none=True) for name, change in servos.items()},
        "landing": {str(name): None if angle is None else number(angle) for name, angle in landing.items()},
    }
    if revision is not None:
        payload["revision"] = operator.index(revision)
    if accept_default:
        payload["accept_default"] = True
    return payload


def leg_number(leg: object) -> int:
    """Return a leg's number, 1 to 6. Raises TypeError for no whole number, as "3", OutOfRangeError for another."""
    if type(leg) is not int and (isinstance(leg, bool) or not isinstance(leg, SupportsIndex)):
        raise TypeError(f"a leg is a whole number, and not {leg!r}; legs are 1 to 6")
    found = operator.index(leg)
    if found not in LEGS:
        raise OutOfRangeError(f"leg {found} does not exist; legs are 1 to 6")
    return found


def number(angle: object, unit: Unit = "deg", leg: str = "", joint: int = 0) -> float:
    """Return an angle in degrees, for JSON. Raises TypeError for a bool, a string, and all else that is no number.

    An angle outside 0 to 180 degrees by at most ROUNDING_DEG becomes that limit. Raises OutOfRangeError for one farther
    outside; `leg` ("leg 4, ") and `joint` (0: none) begin the sentence.

    >>> number(180.0000000000001), number(-1e-15), number(1.5707963267948966, "rad")
    (180.0, 0.0, 90.0)
    """
    degrees = _plain(angle)
    if unit == "rad":
        degrees = math.degrees(degrees)
    elif unit != "deg":
        raise ValueError(f'the unit of angles is "deg" or "rad", and not {unit!r}')
    if 0 <= degrees <= MAX_DEG:
        return degrees
    if not -ROUNDING_DEG <= degrees <= MAX_DEG + ROUNDING_DEG:  # or it is no number (NaN)
        which = f"{leg}joint {joint}: " if joint else ""
        raise OutOfRangeError(f"{which}{degrees:g}° is not between 0 and 180°")
    return min(max(degrees, 0.0), MAX_DEG)


def _plain(angle: object) -> float:
    if type(angle) is float or type(angle) is int:  # a stream's, usually
        return angle
    if (found := plain(angle)) is None:
        raise TypeError(f"an angle is a number of degrees, and not {angle!r}")
    return found
