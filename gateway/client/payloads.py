"""The payloads of commands, from whatever a program has for numbers."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, SupportsFloat, SupportsIndex

from schemas.robot import JOINTS, LEGS

if TYPE_CHECKING:
    from schemas.calibration import ServoChange

Angle = SupportsFloat | SupportsIndex
"""Degrees: an int, a float, or whatever is one, such as numpy's `float32` and `int64`. A bool is not."""


def leg_payload(op: str, angles_deg: Sequence[Angle] = ()) -> dict[str, Any]:
    """The payload of a leg's command: one operation for its three servos, with three angles unless it stops.

    Raises ValueError unless there are three, TypeError where one is no number.

    >>> leg_payload("set", (90, 45.5, 120))["servos"][1]
    {'op': 'set', 'angle_deg': 45.5}
    """
    if op == "stop":
        return {"servos": [servo_payload(op)] * 3}
    if len(angles_deg) != len(JOINTS):
        raise ValueError(f"{len(angles_deg)} angles; a leg has three joints")
    return {"servos": [{"op": op, "angle_deg": number(angle_deg)} for angle_deg in angles_deg]}


def legs_payload(op: str, angles_deg: Mapping[int, Sequence[Angle]]) -> dict[str, Any]:
    """The payload of one command for several legs (1 to 6): one operation, three angles (degrees) for each.

    Raises as `leg_payload`, and ValueError for a leg that does not exist.
    """
    legs = {}
    for leg, angles in angles_deg.items():
        if leg not in LEGS:
            raise ValueError(f"leg {leg} does not exist; legs are 1 to 6")
        legs[str(int(leg))] = leg_payload(op, angles)
    return {"legs": legs}


def servo_payload(op: str, angle_deg: Angle | None = None) -> dict[str, Any]:
    """The payload of a servo's command. Raises TypeError where the angle is no number."""
    return {"op": op} if angle_deg is None else {"op": op, "angle_deg": number(angle_deg)}


def calibration_payload(
    servos: "Mapping[int, ServoChange]" = MappingProxyType({}),
    landing: Mapping[int, Angle | None] = MappingProxyType({}),
    *,
    revision: int | None = None,
    accept_default: bool = False,
) -> dict[str, Any]:
    """What changes the calibration; see `Client.calibrate`. Raises TypeError where an angle is no number."""
    payload: dict[str, Any] = {
        "servos": {str(name): change.model_dump(exclude_none=True) for name, change in servos.items()},
        "landing": {str(name): None if angle is None else number(angle) for name, angle in landing.items()},
    }
    if revision is not None:
        payload["revision"] = revision
    if accept_default:
        payload["accept_default"] = True
    return payload


def number(angle_deg: Angle) -> float:
    """An angle as JSON can carry it. Raises TypeError for a bool, a string, or whatever else is no number."""
    if isinstance(angle_deg, int | float) and not isinstance(angle_deg, bool):
        return angle_deg
    if type(angle_deg).__name__ not in ("bool", "bool_"):  # Python's, numpy's
        if isinstance(angle_deg, SupportsFloat):
            return float(angle_deg)
        if isinstance(angle_deg, SupportsIndex):
            return int(angle_deg)
    raise TypeError(f"an angle is a number of degrees, and not {angle_deg!r}")
