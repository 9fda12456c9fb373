"""Reads a TOML file's values into the sections of the settings' table."""

import enum
import math
import tomllib
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import Field, dataclass, fields, is_dataclass
from typing import Any, Final, Literal, TypeVar, cast, get_args, get_origin

from gateway.host.settings_table import (
    FOR_STOPS,
    REMOVED,
    Allowed,
    ControllerSettings,
    Place,
    PowerSettings,
    Section,
    SpiSettings,
    WireSettings,
)
from gateway.words.text import echo, key_name
from schemas.robot import SERVO_IDS

SERVOS: Final = frozenset(map(str, SERVO_IDS))
NO_SETTING: Final = "is no setting"
Fault = tuple[Place, str]
"""The place of a fault, and its sentence."""
S = TypeVar("S", bound=Section)


class VariableText(str):
    """An environment variable's text, which is read as a value of its setting's type."""

    __slots__ = ()


def dotted(place: Place) -> str:
    """Return a place as text: `spi.speed_hz`, `zenoh.listen[0]`. A name that is no bare TOML key is quoted."""
    text = "".join(f"[{part}]" if isinstance(part, int) else f".{key_name(part)}" for part in place)
    return text.removeprefix(".")


def read(kind: type[S], table: object, faults: list[Fault], place: Place = ()) -> S:
    """Return the section (or all settings) in this table.

    Faults are added to `faults`. A value of the wrong type or out of range is replaced by its default.
    """
    if not isinstance(table, Mapping):
        faults.append(_wrong(place, table, "an object"))
        return kind()
    before, found, others = len(faults), dict[str, Any](), dict(table)
    for each in fields(cast("Any", kind)):
        if is_others(each):  # the section's last field; a variable may not add a setting
            keys = [name for name, value in others.items() if not isinstance(value, VariableText)]
            found[each.name] = {name: others.pop(name) for name in keys}
        elif each.name in others:
            allowed = each.metadata.get("allowed", _ANY)
            value = _value(each.type, allowed, others.pop(each.name), (*place, each.name), faults)
            found |= {} if value is None else {each.name: value}
    # An empty removed section, which an earlier installed file still contains, is no fault.
    unknown = (((*place, name), value) for name, value in others.items())
    faults += [(at, REMOVED.get(at, NO_SETTING)) for at, value in unknown if value != {} or at not in REMOVED]
    made = kind(**found)
    if len(faults) == before:
        faults += [((*place, *below), sentence) for below, sentence in made.faults()]
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


def read_for_stops(tables: Mapping[str, Any]) -> tuple[ForStops, list[Fault]]:
    """Return the settings that a Stop needs, and the faults that prevent it: only in [wire], [spi] and the UART.

    An unknown name prevents it in [spi] only, where a misspelt clock or framing would jam the controller.
    """
    found = list[Fault]()
    wire = read(WireSettings, tables.get("wire", {}), found, ("wire",))
    spi = read(SpiSettings, tables.get("spi", {}), found, ("spi",))
    controller = read(ControllerSettings, tables.get("controller", {}), found, ("controller",))
    power = read(PowerSettings, tables.get("power", {}), found, ("power",))
    left = [each for each in found if each[0] == ("spi", "protocol") or each[0] not in REMOVED]
    needed = [(at, why) for at, why in left if len(at) == 1 or at[0] == "spi" or at[1] in FOR_STOPS[str(at[0])]]
    prevent = [fault for fault in needed if fault[0][0] != "power"]
    return ForStops(wire, spi.of(wire), controller, power if prevent == needed else None), prevent


_ANY: Final = Allowed("")
_ARRAY: Final = 'a valid array, such as ["tcp/127.0.0.1:7447"]'
_NAMES: Final = {bool: "a valid boolean", int: "a valid integer", float: "a valid number", str: "a valid string"}


def _value(kind: Any, allowed: Allowed, value: Any, place: Place, faults: list[Fault]) -> Any:
    """Return the value in its setting's type; None if it is wrong, whose faults are added."""
    if is_dataclass(kind):
        return read(cast("type[Section]", kind), value, faults, place)
    before, of = len(faults), get_origin(kind)
    found: Any
    if isinstance(value, VariableText):
        value = _typed(kind, value)
    if of is tuple and isinstance(value, list | tuple):
        found = tuple(_value(get_args(kind)[0], _ANY, each, (*place, at), faults) for at, each in enumerate(value))
    elif of is Mapping and isinstance(value, Mapping):
        known = "an id is the leg (1 to 6) and the joint (1 to 3), such as 32"
        faults += [(place, f"{key_name(name)} is no servo; {known}") for name in value.keys() - SERVOS]
        each_kind = get_args(kind)[1]
        found = {name: _value(each_kind, allowed, each, (*place, name), faults) for name, each in value.items()}
    elif wanted := _wanted(kind, allowed.limits, value):
        faults.append(_wrong(place, value, wanted))
        return None
    else:
        found = kind(value) if kind is float or isinstance(kind, enum.EnumMeta) else value
    sentence = "" if len(faults) > before else allowed.fault(found)
    faults += [(place, sentence)] if sentence else []
    return found


_BOOLEANS: Final = {
    **dict.fromkeys(("true", "1", "yes", "on"), True),
    **dict.fromkeys(("false", "0", "no", "off"), False),
}


def _typed(kind: Any, text: str) -> Any:
    """Return a variable's text as the value that a file would have; the text itself for texts, or if it is no value."""
    if kind is bool:
        return _BOOLEANS.get(text.lower(), str(text))
    with suppress(ValueError, RecursionError):
        if kind in {int, float} or get_origin(kind) is tuple:
            return tomllib.loads(f"value = {text}")["value"]
    return str(text)


def _wrong(place: Place, value: object, wanted: str) -> Fault:
    return (place, f"{echo(value)} is not allowed: input should be {wanted}")


def words(kind: Any) -> tuple[str, ...]:
    """Return the words that a setting of this type may be; empty if it is no choice among words."""
    if get_origin(kind) is Literal:
        return get_args(kind)
    return tuple(map(str, kind)) if isinstance(kind, enum.EnumMeta) else ()


def _wanted(kind: Any, limits: tuple[float, float] | None, value: Any) -> str:
    """Return what a value should be instead, or "" if it is of this kind and within the limits."""
    if choice := words(kind):
        return "" if value in choice else " or ".join(f"'{word}'" for word in choice)
    if kind not in _NAMES:
        return "an object" if get_origin(kind) is Mapping else _ARRAY
    right = isinstance(value, int | float if kind is float else kind) and isinstance(value, bool) == (kind is bool)
    if not right or kind in {bool, str}:
        return "" if right else _NAMES[kind]
    low, high = limits or (-math.inf, math.inf)
    if not -math.inf < value < math.inf:
        return "a finite number"
    return f"greater than or equal to {low}" if value < low else f"less than or equal to {high}" if value > high else ""
