"""The payloads of commands, from any kind of number."""

import operator
from collections.abc import Collection, Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final, SupportsFloat, SupportsIndex, TypeGuard, cast

from schemas.robot import JOINTS, LEGS, MAX_DEG, SERVO_IDS

if TYPE_CHECKING:
    from schemas.calibration import ServoChange

Angle = SupportsFloat | SupportsIndex
"""Degrees: an int, a float, or a number such as numpy's `float32` and `int64`; no bool."""
MIN_DEG: Final = 0.0
ROUNDING_DEG: Final = 0.005
"""Half of the protocol's hundredth: an angle so close outside 0 to 180 is the limit, after inexact arithmetic."""

LegAngles = dict[int, tuple[float, ...]]
"""The three angles of each leg, by its number."""


def leg_payload(op: str, angles_deg: Sequence[Angle] = ()) -> dict[str, Any]:
    """The payload of a leg's command: one operation for its three servos, with three angles unless it stops.

    Raises ValueError unless there are three, TypeError if one is no number, or if they have no order.

    >>> leg_payload("set", (90, 45.5, 120))["servos"][1]
    {'op': 'set', 'angle_deg': 45.5}
    """
    return {"servos": [servo_payload(op)] * 3} if op == "stop" else _setpoint(op, _leg_angles(angles_deg))


def _leg_angles(angles_deg: Sequence[Angle]) -> tuple[float, ...]:
    if not _is_row(angles_deg):
        raise TypeError(f"a leg's angles are a list, a tuple or an array of three, and not {angles_deg!r}")
    if len(angles_deg) != len(JOINTS):
        raise ValueError(f"{len(angles_deg)} angles; a leg has three joints")
    return tuple([number(angle_deg) for angle_deg in angles_deg])


def _setpoint(op: str, angles: tuple[float, ...]) -> dict[str, Any]:
    return {"servos": [{"op": op, "angle_deg": angle} for angle in angles]}


def row(angles_deg: tuple[Angle | Sequence[Angle], ...]) -> Sequence[Angle]:
    """A leg's angles, whether they are given one by one or as one list, tuple or array.

    >>> row((90, 45, 120)), row(([90, 45, 120],))
    ((90, 45, 120), [90, 45, 120])
    """
    match angles_deg:
        case [one] if _is_row(one):
            return one
        case _:
            return cast(tuple[Angle, ...], angles_deg)  # `number` checks each


def _is_row(value: object) -> TypeGuard[Sequence[Angle]]:
    """Also numpy's arrays, which are no Sequence; no set and no dict, which have no order of joints."""
    if type(value) is tuple or type(value) is list:  # a stream's, usually; an ABC's check takes ten calls
        return True
    indexed = isinstance(value, Collection) and hasattr(value, "__getitem__")
    return indexed and not isinstance(value, str | bytes | Mapping)


def legs_payload(op: str, angles_deg: Mapping[int, Sequence[Angle]]) -> dict[str, Any]:
    """The payload of one command for several legs (1 to 6): one operation, three angles (degrees) for each.

    Raises as `leg_payload` and `leg_number`.
    """
    if op == "stop":
        return {"legs": {str(leg_number(leg)): leg_payload(op) for leg in angles_deg}}
    return {"legs": setpoints(op, legs_angles(angles_deg))}


def legs_angles(angles_deg: Mapping[int, Sequence[Angle]]) -> LegAngles:
    """The numbers of several legs (1 to 6). Raises as `leg_payload` and `leg_number`."""
    if not isinstance(angles_deg, Mapping):
        raise TypeError(f"legs and their angles are a dict, such as {{3: (90, 45, 120)}}, and not {angles_deg!r}")
    return {leg_number(leg): _leg_angles(angles) for leg, angles in angles_deg.items()}


def setpoints(op: str, angles: LegAngles) -> dict[str, Any]:
    """The legs of a payload, from the numbers of `legs_angles`: a stream reads each angle once."""
    return {str(leg): _setpoint(op, each) for leg, each in angles.items()}


def servo_payload(op: str, angle_deg: Angle | None = None) -> dict[str, Any]:
    """The payload of a servo's command. Raises TypeError if the angle is no number."""
    return {"op": op} if angle_deg is None else {"op": op, "angle_deg": number(angle_deg)}


def calibration_payload(
    servos: "Mapping[int, ServoChange]" = MappingProxyType({}),
    landing: Mapping[int, Angle | None] = MappingProxyType({}),
    *,
    revision: int | None = None,
    accept_default: bool = False,
) -> dict[str, Any]:
    """The payload that changes the calibration; see `Client.calibrate`. Raises TypeError if an angle is no number."""
    payload: dict[str, Any] = {
        "servos": {str(name): change.model_dump(exclude_none=True) for name, change in servos.items()},
        "landing": {str(name): None if angle is None else number(angle) for name, angle in landing.items()},
    }
    if revision is not None:
        payload["revision"] = revision
    if accept_default:
        payload["accept_default"] = True
    return payload


def leg_number(leg: object) -> int:
    """A leg's number, 1 to 6. Raises TypeError for no whole number, such as "3", ValueError for another one."""
    return _named("leg", leg, LEGS, "legs are 1 to 6")


def servo_number(servo_id: object) -> int:
    """A servo's id, 11 to 63. Raises TypeError for no whole number, ValueError for an id that does not exist."""
    return _named("servo", servo_id, SERVO_IDS, "an id is the leg (1 to 6) and the joint (1 to 3), such as 32")


def _named(what: str, name: object, known: Collection[int], which: str) -> int:
    if type(name) is not int and (isinstance(name, bool) or not isinstance(name, SupportsIndex)):
        raise TypeError(f"a {what} is a whole number, and not {name!r}; {which}")
    number = operator.index(name)
    if number not in known:
        raise ValueError(f"{what} {number} does not exist; {which}")
    return number


def number(angle_deg: object) -> float:
    """An angle as a number for JSON. Raises TypeError for a bool, a string, and all else that is no number.

    One that is outside 0 to 180 degrees by no more than ROUNDING_DEG becomes that limit.

    >>> number(180.0000000000001), number(-1e-15)
    (180.0, 0.0)
    """
    if type(angle_deg) is float or type(angle_deg) is int:  # a stream's, usually
        return _within_limits(angle_deg)
    if type(angle_deg).__name__ not in ("bool", "bool_"):  # Python's, numpy's
        if isinstance(angle_deg, SupportsFloat):
            return _within_limits(float(angle_deg))
        if isinstance(angle_deg, SupportsIndex):
            return operator.index(angle_deg)
    raise TypeError(f"an angle is a number of degrees, and not {angle_deg!r}")


def _within_limits(angle_deg: float) -> float:
    if MAX_DEG < angle_deg <= MAX_DEG + ROUNDING_DEG:
        return MAX_DEG
    if MIN_DEG - ROUNDING_DEG <= angle_deg < MIN_DEG:
        return MIN_DEG
    return angle_deg
