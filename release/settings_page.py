"""Made from the table of settings: its rows in docs/interface.md, and the JSON Schema of gateway.toml."""

import json
from collections.abc import Mapping
from dataclasses import MISSING, fields, is_dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple, get_args, get_origin

from gateway.host.settings_reader import is_others, words
from gateway.host.settings_table import START_STAGGER_MS, Allowed
from gateway.model.protocols import SpiProtocol
from gateway.robot.settings import Settings
from schemas.robot import SERVO_IDS

ROOT: Final = Path(__file__).parents[1]


class Setting(NamedTuple):
    """One setting, as the table has it."""

    kind: Any
    default: Any
    """MISSING if there is none: a servo's setting."""
    allowed: Allowed


def settings(section: Any = Settings, prefix: str = "") -> dict[str, Setting]:
    """Return every setting by its dotted name; N is a servo."""
    found: dict[str, Setting] = {}
    for each in fields(section):
        if is_others(each):
            continue
        name = f"{prefix}{each.name}"
        inner = get_args(each.type)[1] if get_origin(each.type) is Mapping else each.type
        if is_dataclass(inner):
            found |= settings(inner, f"{name}.N." if inner is not each.type else f"{name}.")
        else:
            found[name if inner is each.type else f"{name}.N"] = Setting(inner, each.default, each.metadata["allowed"])
    return found


def limits(setting: Setting) -> str:
    """Return the range as the table writes it: `0 to 1000`, or the words."""
    if setting.allowed.limits is not None:
        return " to ".join(map(str, setting.allowed.limits))
    return ", ".join(f"`{word}`" for word in words(setting.kind))


def settings_rows() -> list[tuple[str, ...]]:
    """Return the rows of docs/interface.md."""
    rows: list[tuple[str, ...]] = []
    for name, setting in settings().items():
        default = "none" if setting.default is MISSING else f"`{json.dumps(setting.default)}`"
        if name == "spi.speed_hz":
            default = "; ".join(f"`{each.speed_hz}` with `{each}`" for each in SpiProtocol)
        if name == "limits.start_stagger_ms":
            default = f"`{START_STAGGER_MS}`; `0.0` with a power board or `{SpiProtocol.ELKAPOD_2025}`"
        if name == "spi.framing":  # required for a real device
            default = f"none; {default} with `--sim`"
        rows.append((f"`{name}`", default, limits(setting), setting.allowed.meaning))
    return rows


_TYPES: Final = {bool: "boolean", int: "integer", float: "number", str: "string"}


def schema() -> dict[str, Any]:
    """Return the JSON Schema of gateway.toml."""
    servo = "^(?:" + "|".join(map(str, SERVO_IDS)) + ")$"
    whole: dict[str, Any] = _object("hexapod-gateway: gateway.toml")
    for name, setting in settings().items():
        at = whole
        *path, last = name.split(".")
        for part in path:
            if part == "N":
                at = at.setdefault("patternProperties", {}).setdefault(servo, _object())
            else:
                at = at["properties"].setdefault(part, _object())
        where = at.setdefault("patternProperties", {}) if last == "N" else at["properties"]
        where[servo if last == "N" else last] = _value(setting)
    return whole


def _object(title: str = "") -> dict[str, Any]:
    return ({"title": title} if title else {}) | {"type": "object", "properties": {}, "additionalProperties": False}


def _value(setting: Setting) -> dict[str, Any]:
    kind, items = setting.kind, {}
    if get_origin(kind) is tuple:
        found: dict[str, Any] = {"type": "array", "items": {"type": _TYPES[get_args(kind)[0]]}}
    elif choice := words(kind):
        found = {"enum": list(choice)}
    else:
        found = {"type": _TYPES[kind]}
    if setting.allowed.limits is not None:
        items = dict(zip(("minimum", "maximum"), setting.allowed.limits, strict=True))
    low = setting.allowed.limits[0] if setting.allowed.limits else None
    if setting.default is not MISSING and (low is None or setting.default >= low):
        items |= {"default": setting.default}
    return found | items | ({"description": setting.allowed.meaning} if setting.allowed.meaning else {})
