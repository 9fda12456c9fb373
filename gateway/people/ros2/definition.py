"""A message type as text (`ros2msg`), as recordings carry it, so that any program can read what is in them."""

from typing import Final

from gateway.people.ros2.cdr import Message

_BETWEEN: Final = "=" * 80 + "\n"


def definition(kind: type[Message]) -> str:
    """The type's fields, and behind it those of every type that it has in it."""
    inner: dict[str, type[Message]] = {}
    text = _lines(kind, inner)
    return text + "".join(f"{_BETWEEN}MSG: {_short(name)}\n{_lines(found, {})}" for name, found in inner.items())


def _lines(kind: type[Message], inner: dict[str, type[Message]]) -> str:
    lines = [f"{type_name} {name}={value}" for type_name, name, value in kind.CONSTANTS]
    for name, element, many in kind.FIELDS:
        shown = element if isinstance(element, str) else _short(element.TYPE)
        lines.append(f"{shown}{'[]' if many else ''} {name}")
        if not isinstance(element, str) and element.TYPE not in inner:
            inner[element.TYPE] = element
            _lines(element, inner)
    return "".join(f"{line}\n" for line in lines)


def _short(name: str) -> str:
    """`std_msgs/msg/Header` → `std_msgs/Header`."""
    return name.replace("/msg/", "/")
