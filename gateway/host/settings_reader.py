"""Reads a TOML file's values, or the environment's text, into the sections of the settings' table."""

import enum
import math
from collections.abc import Mapping
from dataclasses import Field, dataclass, fields, is_dataclass
from typing import Any, Final, Literal, NamedTuple, TypeVar, cast, get_args, get_origin

from gateway.host.settings_table import (
    FOR_STOPS,
    Allowed,
    ControllerSettings,
    PowerSettings,
    Section,
    SpiSettings,
    WireSettings,
)
from gateway.text import echo, key_name
from schemas.robot import SERVO_IDS

Place = tuple[int | str, ...]
"""Path to a value: ("spi", "speed_hz"), ("zenoh", "listen", 0), ("limits", "servos", "11", "min_deg")."""
SERVOS: Final = frozenset(map(str, SERVO_IDS))
NO_SETTING: Final = "is no setting"
S = TypeVar("S")


class SettingFault(NamedTuple):
    """A fault: its place and its sentence."""

    place: Place
    sentence: str


class Text(str):
    """A value from the environment. Its text is converted to the setting's type; a file's value is not."""

    __slots__ = ()


def dotted(place: Place) -> str:
    """Return a place as text: `spi.speed_hz`, `zenoh.listen[0]`. A name that is no bare TOML key is quoted."""
    text = "".join(f"[{part}]" if isinstance(part, int) else f".{key_name(part)}" for part in place)
    return text.removeprefix(".")


def read(kind: type[S], table: object, faults: list[SettingFault], place: Place = ()) -> S:
    """Return the section (or all settings) in this table.

    Faults are added to `faults`. A value of the wrong type or out of range is replaced by its default.
    """
    if not isinstance(table, Mapping):
        faults.append(_wrong(place, table, "an object"))
        return kind()
    found: dict[str, Any] = {}
    before = len(faults)
    known = [each for each in fields(cast("Any", kind)) if not is_others(each)]
    for each in known:
        if each.name in table:
            allowed = each.metadata.get("allowed", _ANY)
            value = _value(each.type, allowed, table[each.name], (*place, each.name), faults)
            if value is not None:
                found[each.name] = value
    others = {name: value for name, value in table.items() if name not in {each.name for each in known}}
    takes_others = next(filter(is_others, fields(cast("Any", kind))), None)
    if takes_others is not None:
        found[takes_others.name] = others
    else:
        faults += [SettingFault((*place, name), NO_SETTING) for name in others]
    made = kind(**found)
    sentence = made.fault() if isinstance(made, Section) and len(faults) == before else ""
    if sentence:
        faults.append(SettingFault(place, sentence))
    return made


def is_others(each: "Field[Any]") -> bool:
    """Return whether the field collects all other keys of its section."""
    return "others" in each.metadata


@dataclass(frozen=True)
class ForStops:
    """The settings that a Stop needs."""

    wire: WireSettings
    spi: SpiSettings
    controller: ControllerSettings
    power: PowerSettings | None
    """None: the section is wrong, which must not prevent Stops."""


def read_for_stops(tables: Mapping[str, Any]) -> tuple[ForStops, list[SettingFault]]:
    """Return the settings that a Stop needs, and the faults that prevent it: only in [wire], [spi] and the UART."""
    of_spi, of_controller, of_power = list[SettingFault](), list[SettingFault](), list[SettingFault]()
    wire = read(WireSettings, tables.get("wire", {}), of_spi, ("wire",))
    spi = read(SpiSettings, tables.get("spi", {}), of_spi, ("spi",))
    controller = read(ControllerSettings, tables.get("controller", {}), of_controller, ("controller",))
    power = read(PowerSettings, tables.get("power", {}), of_power, ("power",))
    prevent = of_spi
    prevent += [fault for fault in of_controller if _needed(fault)]
    return ForStops(wire, spi.of(wire), controller, None if any(map(_needed, of_power)) else power), prevent


def _needed(fault: SettingFault) -> bool:
    section, *name = fault.place
    return not name or name[0] in FOR_STOPS[str(section)]


_ANY: Final = Allowed("")


def _value(kind: Any, allowed: Allowed, value: object, place: Place, faults: list[SettingFault]) -> Any:
    if is_dataclass(kind):
        return read(cast("type[Any]", kind), value, faults, place)
    if get_origin(kind) is tuple:
        return _array(get_args(kind)[0], allowed, value, place, faults)
    if get_origin(kind) is not None and get_origin(kind) is not Literal:
        return _by_servo(get_args(kind)[1], allowed, value, place, faults)
    fault = _wrong_type(kind, value) or _outside(kind, allowed, value)
    if fault:
        faults.append(_wrong(place, value, fault))
        return None
    converted = _converted(kind, value)
    if sentence := allowed.fault(converted):
        faults.append(SettingFault(place, sentence))
    return converted


def _array(
    kind: Any, allowed: Allowed, value: object, place: Place, faults: list[SettingFault]
) -> tuple[Any, ...] | None:
    if not isinstance(value, list | tuple):
        faults.append(_wrong(place, value, "a valid array"))
        return None
    before = len(faults)
    found = tuple(_value(kind, _ANY, each, (*place, at), faults) for at, each in enumerate(value))
    sentence = allowed.fault(found) if len(faults) == before else ""
    if sentence:
        faults.append(SettingFault(place, sentence))
    return found


def _by_servo(
    kind: Any, allowed: Allowed, value: object, place: Place, faults: list[SettingFault]
) -> dict[str, Any] | None:
    if not isinstance(value, Mapping):
        faults.append(_wrong(place, value, "an object"))
        return None
    for name in value.keys() - SERVOS:
        known = "an id is the leg (1 to 6) and the joint (1 to 3), such as 32"
        faults.append(SettingFault(place, f"{key_name(name)} is no servo; {known}"))
    stated = [(name, each) for name, each in value.items() if name in SERVOS]
    found = {name: _value(kind, allowed, each, (*place, name), faults) for name, each in stated}
    return {name: each for name, each in found.items() if each is not None}


def _wrong(place: Place, value: object, wanted: str) -> SettingFault:
    return SettingFault(place, f"{echo(value)} is not allowed: input should be {wanted}")


_TRUE, _FALSE = frozenset({"true", "1", "yes", "on"}), frozenset({"false", "0", "no", "off"})
_WANTED: Final[Mapping[type, tuple[str, str]]] = {
    bool: ("a valid boolean", "unable to interpret input"),
    int: ("a valid integer", "unable to parse string as an integer"),
    float: ("a valid number", "unable to parse string as a number"),
    str: ("a valid string", ""),
}


def words(kind: Any) -> tuple[str, ...]:
    """Return the words that a setting of this type may be; empty if it is no choice among words."""
    if get_origin(kind) is Literal:
        return get_args(kind)
    return tuple(map(str, kind)) if isinstance(kind, enum.EnumMeta) else ()


def _wrong_type(kind: Any, value: object) -> str:
    if choice := words(kind):
        return "" if isinstance(value, str) and value in choice else " or ".join(f"'{word}'" for word in choice)
    wanted, unread = _WANTED[kind]
    if isinstance(value, Text) and kind is not str:
        return f"{wanted}, {unread}" if _converted(kind, value) is None else ""
    right = isinstance(value, int | float if kind is float else kind)
    return "" if right and isinstance(value, bool) == (kind is bool) else wanted


def _outside(kind: Any, allowed: Allowed, value: object) -> str:
    if kind not in {int, float}:
        return ""
    number = _converted(kind, value)
    if not math.isfinite(number):
        return "a finite number"
    low, high = allowed.limits or (-math.inf, math.inf)
    if number < low:
        return f"greater than or equal to {low:g}"
    return f"less than or equal to {_plain(high)}" if number > high else ""


def _plain(limit: float) -> str:
    return str(int(limit)) if limit == int(limit) else str(limit)


def _converted(kind: Any, value: Any) -> Any:
    """Return the value in its setting's type, or None if the text is no such value."""
    if isinstance(kind, enum.EnumMeta):
        return kind(str(value))
    if not isinstance(value, Text):
        return float(value) if kind is float else value
    if kind is bool:
        return True if value.lower() in _TRUE else False if value.lower() in _FALSE else None
    try:
        return kind(value)
    except ValueError:
        return None
