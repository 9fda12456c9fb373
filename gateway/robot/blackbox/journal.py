"""The core's events and state as JSON, so that a run can be decided again from a keyframe. Pure.

A keyframe has what differs from a new supervisor with the same rules, by the path of each part. A new field of the core
needs nothing here. A version that lacks a field of a keyframe, or a class of an event, rejects it with a sentence.

| value | JSON |
|---|---|
| None, bool, int, float, str | itself |
| tuple | array |
| dict, set, frozenset, list | `{"dict": [[key, value], …]}`, `{"set": [value, …]}` |
| operation of a servo | `{"ServoOp": [operation, angle]}` |
| enum | `{"Cause": "estop"}` |
| dataclass, NamedTuple, payload | `{"Command": {field: value}}` without defaults |
| request or calibration that has occurred before | `{"Command": number}`: counted from 0 |

A callable is null. A token is a keyed hash of itself, so that the journal shows which lease was used, and opens none.
"""

import sys
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from copy import copy
from dataclasses import MISSING, fields, is_dataclass
from enum import Enum
from functools import cache, lru_cache
from hashlib import blake2b
from operator import attrgetter
from os import urandom
from typing import Any, Final

from pydantic import BaseModel
from pydantic_core import from_json, to_json

from gateway.model.angle_limits import AngleLimits
from gateway.model.calibration import RobotCalibration
from gateway.model.frames import OP_START, OP_STOP, SETS, STARTS, STOP, ServoOp
from gateway.robot.core.events import Command, Effect, Event, Request, batches
from gateway.robot.core.rules import Rules
from gateway.robot.core.supervisor import ALL_EVENTS, Supervisor

FORMAT: Final = 1
SECRETS: Final = frozenset({"lease", "token", "fresh_token", "_token", "_by_token"})
"""Fields with tokens: a text, or the keys of a dict."""
_KEY: Final = urandom(16)
_CORE: Final = "gateway.robot.core."
_VALUES: Final = frozenset({f"{_CORE}events", f"{_CORE}rules"})
"""Modules of the core whose objects are values, not parts of its state."""
_MUTABLE: Final = (dict, set)
_SCALARS: Final = frozenset({type(None), bool, int, float, str})
_CONTAINERS: Final = frozenset({set, frozenset, list, dict})
_BY_NAME: Final[dict[str, Any]] = {each.__name__: each for each in _CONTAINERS}
_SHARED: Final = (Request, RobotCalibration)
"""Objects that are compared by identity, or large."""
_LEFT_OUT: Final = frozenset({"frames", "moves", "written", "stopped"})
"""Fields of a request that follow from others, or are for its answer alone."""
_CHANGING: Final = ("left", "coalesced")
"""Fields of a command that a step changes: an event is written after its step, and has its first values."""


class JournalError(ValueError):
    """A journal that this version cannot read."""


@lru_cache(64)
def token_number(token: str) -> int:
    """Return a token's number in the journal, 1 to 2³²−1."""
    return int.from_bytes(blake2b(token.encode(), key=_KEY, digest_size=4).digest()) or 1


def token_text(number: int) -> str:
    """Return the token that replaces the one with this number."""
    return f"{number:08x}"


Mask = Callable[[Any], Any]


# ---- values as JSON


def masked(value: Any) -> Any:
    """Return the content of a field of SECRETS with each token replaced."""
    if isinstance(value, dict):
        return {masked(key): each for key, each in value.items()}
    return token_text(token_number(value)) if value else value


@cache
def _defaults_of(kind: Any) -> dict[str, Any]:
    """Return the default of each field of a dataclass, NamedTuple or payload (MISSING: it has none)."""
    if is_dataclass(kind):
        factories = {each.name: each.default_factory for each in fields(kind)}
        made = {name: factory() for name, factory in factories.items() if factory is not MISSING}
        return {each.name: made.get(each.name, each.default) for each in fields(kind)}
    if issubclass(kind, BaseModel):
        return dict.fromkeys(kind.model_fields, MISSING)
    return {name: kind._field_defaults.get(name, MISSING) for name in kind._fields}


@cache
def _written_of(kind: Any) -> tuple[list[tuple[str, Any]], Callable[[Any], tuple[Any, ...]]]:
    """Return the names and defaults of the fields that are written, and what gets their values (and two more)."""
    written = [(name, default) for name, default in _defaults_of(kind).items() if name not in _LEFT_OUT]
    return written, attrgetter(*(name for name, _ in written), "__class__", "__class__")


class _Writer:
    """Writes one text's values, and counts what occurs more than once. `mask` replaces tokens."""

    def __init__(self, mask: Mask) -> None:
        self._mask = mask
        self._shared: dict[int, int] = {}

    def plain(self, value: Any) -> Any:
        kind = type(value)
        if kind in _SCALARS:
            return value
        if kind is tuple:
            return [each if type(each) in _SCALARS else self.plain(each) for each in value]
        if kind in _CONTAINERS:
            pairs = value.items() if kind is dict else value
            return {kind.__name__: [self.plain(each) for each in pairs]}
        if isinstance(value, Enum):
            return {kind.__name__: value._value_}
        return None if callable(value) else {kind.__name__: self._content(value)}

    def _content(self, value: Any) -> Any:
        if type(value) is ServoOp:
            return [int(value.op), value.angle_cdeg]
        if isinstance(value, _SHARED):
            if id(value) in self._shared:
                return self._shared[id(value)]
            self._shared[id(value)] = len(self._shared)
        kind: Any = type(value)
        written, values_of = _written_of(kind)
        return {
            name: self.plain(self._mask(each) if name in SECRETS else each)
            for (name, default), each in zip(written, values_of(value), strict=False)
            if each is not default and each != default
        }


class _Reader:
    """Reads the values of one text. Raises JournalError, and what a forged value raises in its class."""

    def __init__(self) -> None:
        self._shared: list[Any] = []

    def value(self, plain: Any) -> Any:
        if isinstance(plain, list):
            return tuple(map(self.value, plain))
        if not isinstance(plain, dict):
            return plain
        ((name, content),) = plain.items()
        if name == "dict":
            return {self.value(key): self.value(each) for key, each in content}
        if name in _BY_NAME:
            return _BY_NAME[name](map(self.value, content))
        kind = _classes().get(name)
        if kind is None:
            raise JournalError(f"it has a {name}, which this version does not know")
        return kind(content) if issubclass(kind, Enum) else self._made(kind, content)

    def _made(self, kind: Any, content: Any) -> Any:
        if kind is ServoOp:
            op, angle_cdeg = content
            return STOP if op == OP_STOP else (STARTS if op == OP_START else SETS)[angle_cdeg]
        if isinstance(content, int):
            return self._shared[content]
        known = _defaults_of(kind)
        if unknown := content.keys() - known:
            raise JournalError(f"its {kind.__name__} has {unknown.pop()}, which this version does not know")
        if issubclass(kind, tuple | BaseModel):
            found = {name: self.value(each) for name, each in content.items()}
            return kind(**found) if issubclass(kind, tuple) else kind.model_construct(**found)
        made = object.__new__(kind)
        if issubclass(kind, _SHARED):
            self._shared.append(made)
        for name, default in known.items():
            object.__setattr__(made, name, self.value(content[name]) if name in content else copy(default))
        if kind is Command:
            made.__post_init__()
            made.left = content.get("left", made.left)
        return made


@cache
def _classes() -> Mapping[str, type]:
    """Return the classes of values, by name: those of the core, and those that it uses."""
    rooms = ("schemas.calibration", "gateway.model.", _CORE)
    modules = [sys.modules[name] for room in rooms for name in sorted(sys.modules) if name.startswith(room)]
    found = {each.__name__: each for module in modules for each in vars(module).values() if isinstance(each, type)}
    kinds = Enum, BaseModel, tuple
    return {name: each for name, each in found.items() if issubclass(each, kinds) or is_dataclass(each)}


def plain_event(event: Event, mask: Mask = masked) -> Any:
    """Return an event, also after its step, as JSON's types. Tokens are replaced."""
    (content,) = (plain := _Writer(mask).plain(event)).values()
    for name in _CHANGING if type(event) is Command else ():
        content.pop(name, None)
    return plain


def event_of(plain: Any) -> Event:
    """Return the event. Raises JournalError if this version does not know it."""
    found: Event = _Reader().value(plain)
    if type(found) not in ALL_EVENTS:
        raise JournalError(f"it has a {type(found).__name__} in place of an event")
    return found


def frames_of(effects: Iterable[Effect]) -> list[str]:
    """Return the frames of a step in hexadecimal, as they leave."""
    return [each.frame.data.hex() for batch in batches(effects) for each in batch]


# ---- keyframes


def _is_part(value: Any) -> bool:
    """Return whether this object is a part of the core's state, and no value."""
    kind = type(value)
    inner = kind.__module__.startswith(_CORE) and kind.__module__ not in _VALUES
    return kind is AngleLimits or (inner and not isinstance(value, Enum | tuple | type))


def _names(part: Any) -> dict[str, None]:
    """Return the names of a part's fields, also of those that only its class has set yet."""
    kinds = [kind for kind in type(part).__mro__ if kind is AngleLimits or kind.__module__.startswith(_CORE)]
    named = [name for kind in kinds for name, each in vars(kind).items() if not hasattr(each, "__get__")]
    slots = [name for kind in kinds for name in getattr(kind, "__slots__", ())]
    return dict.fromkeys(name for name in (*named, *slots, *getattr(part, "__dict__", ())) if name[:2] != "__")


def _parts(root: Any) -> Iterator[tuple[str, Any, list[str]]]:
    """Yield each part that is reached from this one, by the shortest path: its path, itself, and its values' names."""
    seen, waiting = {id(root)}, deque([("", root)])
    while waiting:
        path, part = waiting.popleft()
        values: list[str] = []
        inner: list[tuple[str, Any]] = []
        for name in _names(part):
            value = getattr(part, name)
            among = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, tuple) else ()
            parts = [(name, value)] if _is_part(value) else []
            parts += [(f"{name}.{key}", each) for key, each in among if _is_part(each)]
            inner += parts
            if not parts and not callable(value) and id(value) not in seen:
                values.append(name)
                if isinstance(value, _MUTABLE):
                    seen.add(id(value))  # another part may have it, too
        for name, each in sorted(inner, key=lambda named: "." in named[0]):  # names before places, which may change
            if id(each) not in seen:
                seen.add(id(each))
                waiting.append((f"{path}{name}.", each))
        yield path, part, values


class Keyframes:
    """Takes keyframes of one supervisor."""

    def __init__(self, supervisor: Supervisor, mask: Mask = masked) -> None:
        self._mask = mask
        rules = vars(supervisor)["_rules"]
        self._head = {"format": FORMAT, "rules": _Writer(mask).plain(rules)}
        live = {path: part for path, part, _ in _parts(supervisor)}
        self._parts = []
        for path, part, names in _parts(Supervisor(rules)):
            if names:
                values_of = attrgetter("__class__", *names)
                self._parts.append((path, live[path], ("", *names), values_of, values_of(part)))

    def take(self) -> bytes:
        """Return the state between two steps, as JSON."""
        writer, state = _Writer(self._mask), dict[str, dict[str, Any]]()
        for path, part, names, values_of, at_start in self._parts:
            values = values_of(part)
            if values != at_start:
                state[path] = {
                    name: writer.plain(self._mask(value) if name in SECRETS else value)
                    for name, value, before in zip(names, values, at_start, strict=True)
                    if value != before
                }
        return to_json({**self._head, "state": state})


def restored(keyframe: bytes | str, change: Callable[[Rules], Rules] = lambda rules: rules) -> Supervisor:
    """Return a supervisor with this state, and with its rules after `change`. Raises JournalError."""
    found = from_json(keyframe)
    if found["format"] != FORMAT:
        raise JournalError(f"its format is {found['format']}, and this version reads {FORMAT}")
    supervisor = Supervisor(change(_Reader().value(found["rules"])))
    parts = {path: (part, names) for path, part, names in _parts(supervisor)}
    reader = _Reader()
    for path, state in found["state"].items():
        part, names = parts.get(path, (None, ()))
        for name, each in state.items():
            if name not in names:
                raise JournalError(f"its keyframe has {path}{name}, which this version does not know")
            _set(part, name, reader.value(each))
    limits = supervisor.legs.limits
    limits.use(limits.calibration)
    return supervisor


def _set(part: Any, name: str, value: Any) -> None:
    before = getattr(part, name)
    if isinstance(before, _MUTABLE):  # in place, since another part may have it, too
        before.clear()
        before.update(value)
    else:
        setattr(part, name, value)
