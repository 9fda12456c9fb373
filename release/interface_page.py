"""`python -m release.interface_page [--check]`: write the tables of docs/interface.md that come from code, and the JSON
Schema of gateway.toml (docs/settings.schema.json, for editors). With `--check`, list those that are out of date.

A table stands below its heading: fields and words from `schemas`, settings from their table, commands from `--help`.
"""

import json
import re
import sys
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import MISSING, fields, is_dataclass
from itertools import groupby
from typing import Any, Final, NamedTuple, get_args, get_origin

import typer

from gateway.cli import app
from gateway.host.settings_reader import is_others, words
from gateway.host.settings_table import START_STAGGER_MS, Allowed
from gateway.model.protocols import SpiProtocol
from gateway.onboard.commands import setup_app
from gateway.robot.settings import Settings
from release.build import ROOT
from schemas import __main__ as messages
from schemas.robot import SERVO_IDS
from schemas.words import Cause, Kind, Mode, Reason, Value, WatchdogState

PAGE, SCHEMA = ROOT / "docs/interface.md", ROOT / "docs/settings.schema.json"
Rows = Iterable[tuple[str, ...]]
Node = dict[str, Any]
Field = tuple[str, str, str]
"""Name, type and meaning."""
Seen = dict[frozenset[Field], str]
"""The message that explains an object first, by the object's fields; later messages refer to it."""

_SENDER: Final = ("source", "sent_ms", "lease")
_ANSWER: Final = ("accepted", "reason", "detail")
_WORDS: Final = (Reason, Mode, Kind, Cause, WatchdogState)
_CLIENT: Final = ("--connect", "--zenoh-config", "--timeout", "--help")
"""Options of all client commands, explained once."""


def tables() -> dict[str, str]:
    """Return the tables by the heading above them."""
    found: dict[str, str] = {}
    seen: Seen = {}
    for file, text in messages.documents().items():
        document, name = json.loads(text), file.removesuffix(".json")
        rows = list(_fields(document, name))
        for shared, names in (("Sender", _SENDER), ("Answer", _ANSWER)):
            part = [row for row in rows if row[0] in names]
            if len(part) == len(names):
                found.setdefault(f"### {shared}", _table(("field", "type", "meaning"), _joined(part)))
                rows = [row for row in rows if row not in part]
        rows = _folded(rows, name, seen)
        seen.setdefault(frozenset(rows), name)
        found[f"### {name}"] = _table(("field", "type", "meaning"), _joined(rows))
    for kind in _WORDS:
        head = ("value", "meaning", "stops") if kind is Kind else ("value", "meaning")
        found[f"### {kind.__name__}"] = _table(head, _words(kind))
    found["## Settings"] = _table(("setting", "default", "range", "meaning"), settings_rows())
    commands = (*_commands(typer.main.get_command(app), []), *_commands(typer.main.get_command(setup_app), ["setup"]))
    found["## Commands"] = _table(("command", "does", "options"), commands)
    found["### Exit codes"] = _table(("code", "meaning"), _exit_codes())
    return found


def _table(head: tuple[str, ...], rows: Rows) -> str:
    lines = (head, *rows)
    whole = ["|" + "".join(f" {cell} |" if cell else " |" for cell in cells) + "\n" for cells in lines]
    return "".join((whole[0], "|" + "---|" * len(head) + "\n", *whole[1:]))


def _words(kind: type[Value]) -> Rows:
    stops = [("`true`" if each.stops else "",) if isinstance(each, Kind) else () for each in kind]
    return [(f"`{each}`", each.meaning, *more) for each, more in zip(kind, stops, strict=True)]


def _fields(document: Node, name: str) -> Iterator[Field]:
    """Yield the rows of a message. Raises ValueError for a field without a description."""
    sparse = name.endswith("Ack") or name == "Telemetry"
    variants = _variants(document, document)
    closed = all(each.get("additionalProperties") is False for each in variants)
    for field, kind, meaning, optional in _walk(variants, document, ""):
        if not meaning:
            raise ValueError(f"{name}.{field} has no description in schemas/")
        shown = re.sub(r"\(?(\w+) or null\)?", r"\1?", kind).replace(" or null", "?")
        yield (
            field,
            f"{shown.rstrip('?')}{'?' * (not sparse and (optional if closed else shown.endswith('?')))}",
            meaning,
        )


def _folded(rows: list[Field], name: str, seen: Seen) -> list[Field]:
    """Replace the fields of an object that an earlier message explains by a link to that message."""
    joints = {field[: at.end()] for field, _, _ in rows for at in re.finditer(r"\[\]\.|\.N\.|\.", field)}
    for prefix in sorted(joints, key=len, reverse=True):
        part = [row for row in rows if row[0].startswith(prefix)]
        inner = frozenset((field.removeprefix(prefix), kind, meaning) for field, kind, meaning in part)
        known = seen.setdefault(inner, name)
        if known == name or not part:
            continue
        owner, link = re.sub(r"(\[\]|\.N)?\.$", "", prefix), f"as in [{known}](#{known.lower()})"
        own = [row for row in rows if row[0] == owner]
        linked = (owner, own[0][1], f"{own[0][2]}; {link}") if own else (owner, "object", link)
        at = rows.index((own or part)[0])
        rows = [*rows[:at], linked, *(row for row in rows[at:] if row not in (*own, *part))]
    return rows


def _joined(rows: list[Field]) -> Rows:
    """Yield the cells; neighbours of one type and meaning share a row."""
    for (kind, meaning), group in groupby(rows, key=lambda row: row[1:]):
        yield ", ".join(f"`{field}`" for field, _, _ in group), kind, meaning


def _walk(variants: list[Node], document: Node, prefix: str) -> Iterator[tuple[str, str, str, bool]]:
    """Yield each field of these variants (name, type, meaning, if it may be left out), then the fields inside it."""
    for name in dict.fromkeys(name for variant in variants for name in variant["properties"]):
        having = [variant for variant in variants if name in variant["properties"]]
        nodes = [variant["properties"][name] for variant in having]
        kinds = dict.fromkeys(kind for node in nodes for kind in _kinds(node, document))
        if any(kind.startswith("[") for kind in kinds):  # a word that later versions may extend
            kinds.pop("string", None)
        optional = not any(name in variant.get("required", ()) for variant in having)
        inner, joint = _inside(nodes, document)
        meaning = next((text for node in nodes if (text := _described(node, document))), "")
        if not inner or (meaning and (joint != "." or "null" in kinds)):
            only = "" if len(having) == len(variants) else f"with {_operations(having)}: "
            yield f"{prefix}{name}", " or ".join(kinds), meaning and only + meaning, optional
        yield from _walk(inner, document, f"{prefix}{name}{joint}") if inner else ()


def _operations(variants: list[Node]) -> str:
    """Return the words that distinguish these variants from the others."""
    tags = [variant["properties"].get("do") or variant["properties"]["op"] for variant in variants]
    return ", ".join(f"`{word}`" for tag in tags for word in tag.get("enum", [tag.get("const")]))


def _inside(nodes: list[Node], document: Node) -> tuple[list[Node], str]:
    """Return the objects in a field, and what stands between its name and theirs."""
    for each in (variant for node in nodes for variant in _variants(node, document)):
        if "properties" in each:
            return [each], "."
        items = each.get("prefixItems", [each.get("items")])[0], each.get("additionalProperties")
        for item, joint in zip(items, ("[].", ".N."), strict=True):
            objects = [one for one in _variants(item or {}, document) if "properties" in one]
            if objects:
                return objects, joint
    return [], "."


def _variants(node: Any, document: Node) -> list[Node]:
    """Return a schema's alternatives, with references resolved."""
    if not isinstance(node, dict):
        return []
    if "$ref" in node:
        return _variants(document["$defs"][node["$ref"].rpartition("/")[2]], document)
    choices = node.get("anyOf", node.get("oneOf"))
    return [node] if choices is None else [each for choice in choices for each in _variants(choice, document)]


def _described(node: Node, document: Node) -> str:
    own = node.get("description", "")
    return own or next((text for each in node.get("anyOf", ()) if (text := _described(each, document))), "")


def _kinds(node: Node, document: Node) -> Iterator[str]:
    """Yield each type that a value may have, as the page writes it."""
    if "$ref" in node:
        name = node["$ref"].rpartition("/")[2]
        target = document["$defs"][name]
        yield from [f"[{name}](#{name.lower()})"] if "enum" in target else _kinds(target, document)
    elif choices := node.get("anyOf", node.get("oneOf")):
        yield from dict.fromkeys(kind for each in choices for kind in _kinds(each, document))
    elif "enum" in node or "const" in node:
        yield from (f"`{json.dumps(each)}`" for each in node.get("enum", [node.get("const")]))
    elif node["type"] == "array":
        items = node.get("prefixItems", [node.get("items")])
        inner = " or ".join(dict.fromkeys(kind for kind in _kinds(items[0], document)))
        inner = inner.replace(" or string", "") if inner.startswith("[") else inner
        yield (
            f"{len(items)} × ({inner})"
            if "prefixItems" in node and " " in inner
            else (f"{len(items)} × {inner}" if "prefixItems" in node else f"array of {inner}s")
        )
    else:
        yield _limited(node)


def _limited(node: Node) -> str:
    """Return a plain type with its limits."""
    low, high = node.get("minimum"), node.get("maximum")
    if node.get("format") == "date-time":
        return "RFC 3339"
    if "pattern" in node:
        return "32 hex digits"
    if "minLength" in node:
        return f"{node['minLength']} to {node['maxLength']} characters"
    bounded = high is not None and high < 2**53
    return f"{node['type']}, {low:g} to {high:g}" if bounded else str(node["type"])


def _commands(command: Any, path: list[str]) -> Iterator[tuple[str, str, str]]:
    """Yield each command: name, the first paragraph of its help, its own options."""
    if not hasattr(command, "commands") or path == ["calibrate"]:  # (`incidents` alone is `incidents list`)
        does = " ".join((command.help or "").partition("\n\n")[0].split())
        options = [each.opts[0] for each in command.params if each.param_type_name == "option"]
        yield f"`{' '.join(path)}`", does, " ".join(f"`{each}`" for each in options if each not in _CLIENT)
    for name in command.list_commands(None) if hasattr(command, "commands") else ():
        yield from _commands(command.commands[name], [*path, name])


def _exit_codes() -> Rows:
    codes = str(typer.main.get_command(app).epilog).partition("Exit codes: ")[2].rstrip(".")
    return [(code, meaning) for code, _, meaning in (each.partition(" ") for each in codes.split("; "))]


# ---- the settings: their rows, and the JSON Schema of gateway.toml


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


# ---- the page


def page(text: str) -> str:
    """Return the page with the code's tables. Raises ValueError if a table has no place."""
    for heading, table in tables().items():
        place = re.compile(rf"(\n{re.escape(heading)}\n(?:(?!#|\|).*\n)*)(?:\|.*\n)+")
        text, found = place.subn(lambda match, table=table: f"{match[1]}{table}", text, count=1)  # type: ignore[misc]
        if not found:
            raise ValueError(f"docs/interface.md has no table below {heading!r}")
    return text


def main(arguments: list[str]) -> int:
    """Write the page and the schema; with `--check` only compare, and return 1 if one differs."""
    wanted = {
        PAGE: page(PAGE.read_text(encoding="utf-8")),
        SCHEMA: json.dumps(schema(), indent=2, ensure_ascii=False) + "\n",
    }
    stale = [path for path, text in wanted.items() if not path.exists() or path.read_text(encoding="utf-8") != text]
    for path in stale:
        if arguments == ["--check"]:
            sys.stderr.write(f"{path.relative_to(ROOT)} is out of date; run `python -m release.interface_page`\n")
        else:
            path.write_text(wanted[path], encoding="utf-8")
    return int(bool(stale) and arguments == ["--check"])


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
