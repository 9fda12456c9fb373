"""ROS 2 messages: their fields, as bytes (CDR, XCDR1) and back, and their types as text (`ros2msg`).

Every number is aligned to its own size, counted from the end of the four bytes of encapsulation. A string is its length
with the final zero, UTF-8, and the zero; a sequence its count and its elements; an array of numbers its elements; an
empty message one byte.
"""

import struct
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from inspect import get_annotations
from typing import Annotated, Any, ClassVar, Final, NamedTuple, TypeVar, dataclass_transform, get_args, get_origin

byte = Annotated[int, "byte"]
int8 = Annotated[int, "int8"]
uint8 = Annotated[int, "uint8"]
uint16 = Annotated[int, "uint16"]
int32 = Annotated[int, "int32"]
uint32 = Annotated[int, "uint32"]
float32 = Annotated[float, "float32"]
float64 = Annotated[float, "float64"]


class CdrError(ValueError):
    """These bytes are no such message, or this message cannot be written; one sentence."""


class Field(NamedTuple):
    """One field of a message."""

    name: str
    element: "str | type[Message]"
    """A name of `NUMBERS`, `string`, or another message."""
    many: bool = False
    """Whether it is a sequence of them, of any length, or an array."""
    length: int | None = None
    """Of an array: how many numbers it has; None: it is none."""


@dataclass(frozen=True, slots=True)
class Message:
    """A ROS 2 message, made by `ros_msg`: its annotations are its fields, in their order. Sequences are tuples."""

    TYPE: ClassVar[str]
    """As ROS 2 names it, such as `std_msgs/msg/String`."""
    HASH: ClassVar[str]
    """RIHS01 (REP-2016): the same in all distributions that have hashes."""
    FIELDS: ClassVar[tuple[Field, ...]]
    CONSTANTS: ClassVar[tuple[tuple[str, str, int], ...]]
    """Type, name and value."""


M = TypeVar("M", bound=Message)


@dataclass_transform(frozen_default=True)
def ros_msg(type_name: str, sha256: str) -> Callable[[type[M]], type[M]]:
    """Make a class a frozen dataclass, and this type of ROS 2's. `sha256` is what its hash has after `RIHS01_`."""

    def declare(cls: type[M]) -> type[M]:
        annotations = get_annotations(cls)
        made = dataclass(frozen=True, slots=True)(cls)
        made.TYPE, made.HASH = type_name, f"RIHS01_{sha256}"
        made.FIELDS = tuple(_field(name, each) for name, each in annotations.items() if not _is_a(ClassVar, each))
        made.CONSTANTS = tuple(
            (_element(number), name, getattr(made, name))
            for name, each in annotations.items()
            for number in get_args(each)
            if _is_a(ClassVar, each)
        )
        return made

    return declare


def _field(name: str, annotation: Any) -> Field:
    if _is_a(Annotated, annotation) and isinstance(length := get_args(annotation)[1], int):
        return _field(name, get_args(annotation)[0])._replace(length=length)
    if _is_a(tuple, annotation):
        return Field(name, _element(get_args(annotation)[0]), many=True)
    return Field(name, _element(annotation))


def _element(annotation: Any) -> Any:
    """`float64` → "float64", `str` → "string", and a message as it is."""
    if _is_a(Annotated, annotation):
        return get_args(annotation)[1]
    return {bool: "bool", str: "string"}.get(annotation, annotation)


def _is_a(form: Any, annotation: Any) -> bool:
    return get_origin(annotation) is form


NUMBERS: Final = {
    "bool": "?",
    "byte": "B",
    "int8": "b",
    "uint8": "B",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "float32": "f",
    "float64": "d",
}
"""ROS 2's name → the letter of `struct`."""
_SIZES: Final = {letter: struct.calcsize(f"<{letter}") for letter in NUMBERS.values()}
"""Of a number, in bytes: it is aligned to this."""

HEADER: Final = b"\x00\x01\x00\x00"
"""CDR, little endian."""
_ORDERS: Final = {b"\x00\x01": "<", b"\x00\x00": ">"}
_BETWEEN: Final = "=" * 80 + "\n"


def encode(message: Message) -> bytes:
    """Its bytes, with the encapsulation. Raises CdrError where a value does not fit its field."""
    out = bytearray()
    try:
        _write(out, message)
    except (struct.error, UnicodeEncodeError, TypeError) as error:
        raise CdrError(f"{message.TYPE} cannot be written: {error}") from error
    return HEADER + bytes(out)


def decode(kind: type[M], data: bytes) -> M:
    """The message in `data`. Raises CdrError.

    Bytes behind its last field mean nothing: `rmw_serialize` returns as many as it had estimated, up to eight more.
    """
    order = _ORDERS.get(data[:2])
    if order is None or len(data) < len(HEADER):
        raise CdrError(f"{kind.TYPE}: its first bytes ({data[:4].hex(' ')}) are not those of CDR")
    reader = _Reader(data[len(HEADER) :], order)
    try:
        return reader.message(kind)
    except CdrError as error:
        raise CdrError(f"{kind.TYPE}: {error}") from error


def definition(kind: type[Message]) -> str:
    """The type's fields as text, and behind it those of every type that it has in it: any program can read with it
    what is in a recording."""
    inner: dict[str, type[Message]] = {}
    text = _lines(kind, inner)
    return text + "".join(f"{_BETWEEN}MSG: {_short(name)}\n{_lines(found, {})}" for name, found in inner.items())


def _lines(kind: type[Message], inner: dict[str, type[Message]]) -> str:
    lines = [f"{type_name} {name}={value}" for type_name, name, value in kind.CONSTANTS]
    for name, element, many, length in kind.FIELDS:
        shown = element if isinstance(element, str) else _short(element.TYPE)
        lines.append(f"{shown}{f'[{length}]' if length else '[]' if many else ''} {name}")
        if not isinstance(element, str) and element.TYPE not in inner:
            inner[element.TYPE] = element
            _lines(element, inner)
    return "".join(f"{line}\n" for line in lines)


def _short(name: str) -> str:
    """`std_msgs/msg/Header` → `std_msgs/Header`."""
    return name.replace("/msg/", "/")


def _write(out: bytearray, message: Message) -> None:
    for name, element, many, length in message.FIELDS:
        value: Any = getattr(message, name)
        if not many:
            _write_one(out, element, value)
            continue
        if length is None:
            _write_numbers(out, "I", (len(value),))
        elif len(value) != length:
            raise CdrError(f"{name} has {length} numbers, and here are {len(value)}")
        if isinstance(element, str) and element in NUMBERS:
            if value:
                _write_numbers(out, NUMBERS[element], value)
        else:
            for each in value:
                _write_one(out, element, each)
    if not message.FIELDS:
        out.append(0)


def _write_one(out: bytearray, element: str | type[Message], value: Any) -> None:
    if not isinstance(element, str):
        _write(out, value)
    elif element == "string":
        out += bytes(-len(out) % _SIZES["I"])
        out += _string_bytes(value)
    else:
        _write_numbers(out, NUMBERS[element], (value,))


@lru_cache(256)  # names of joints and frames are the same in each message
def _string_bytes(value: str) -> bytes:
    text = value.encode()
    if b"\0" in text:
        raise CdrError("a string ends at its first zero, and this one has a zero inside")
    return struct.pack("<I", len(text) + 1) + text + b"\0"


def _write_numbers(out: bytearray, letter: str, values: Any) -> None:
    out += bytes(-len(out) % _SIZES[letter])
    out += struct.pack(f"<{len(values)}{letter}", *values)


class _Reader:
    """Where it is in the bytes. Nothing is made that the bytes do not hold: a count is compared with them first."""

    def __init__(self, data: bytes, order: str) -> None:
        self._data = data
        self._order = order
        self._count_at = struct.Struct(f"{order}I").unpack_from
        self._at = 0

    @property
    def left(self) -> int:
        """Bytes that are not read yet."""
        return len(self._data) - self._at

    def message(self, kind: type[M]) -> M:
        """The next bytes as a message."""
        if not kind.FIELDS and self.left:  # some writers leave an empty message's one byte out
            self._at += 1
        return kind(*[self._field(field) for field in kind.FIELDS])

    def _field(self, field: Field) -> Any:
        name, element, many, length = field
        try:
            if not many:
                return self._one(element)
            count = self._count() if length is None else length
            if isinstance(element, str) and element in NUMBERS:
                return self._numbers(NUMBERS[element], count) if count else ()
            if count > self.left:  # the smallest element has one byte
                raise CdrError(f"has {count} elements in {self.left} bytes")
            if element == "string":
                return tuple([self._string() for _ in range(count)])
            return tuple([self._one(element) for _ in range(count)])
        except CdrError as error:
            raise CdrError(f"{name}: {error}") from error

    def _one(self, element: str | type[Message]) -> Any:
        if not isinstance(element, str):
            return self.message(element)
        return self._string() if element == "string" else self._numbers(NUMBERS[element], 1)[0]

    def _string(self) -> str:
        length = self._count()
        begin = self._take(length, 1)
        text = self._data[begin : begin + length]
        if text[-1:] == b"\0":  # a length of 0 is an empty string, too
            text = text[:-1]
        try:
            return text.decode()
        except UnicodeDecodeError as error:
            raise CdrError("is no UTF-8") from error

    def _count(self) -> int:
        """Of a string's bytes, or of a sequence's elements."""
        found: int = self._count_at(self._data, self._take(4, 4))[0]
        return found

    def _numbers(self, letter: str, count: int) -> tuple[Any, ...]:
        size = _SIZES[letter]
        return struct.unpack_from(f"{self._order}{count}{letter}", self._data, self._take(count * size, size))

    def _take(self, size: int, alignment: int) -> int:
        """Where the next `size` bytes begin; they are read."""
        begin = self._at + -self._at % alignment
        end = begin + size
        if end > len(self._data):
            raise CdrError(f"ends {end - len(self._data)} bytes too early")
        self._at = end
        return begin
