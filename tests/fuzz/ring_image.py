"""A ring as the fuzzer's input: a byte of options, the header without its padding, and the slots as they are.

`mutate_ring` changes an input as somebody would who knows the format, and mostly puts checksums right again: by chance
alone hardly any change would get past them.
"""

import random
import struct
from collections.abc import Callable
from typing import Final
from zlib import crc32

from gateway.model.black_box import format as form

HEAD: Final = 32
"""Bytes of the header that say something; the fuzzer need not find out that the rest is padding."""
BODY: Final = 1 + HEAD
MAX_SLOTS: Final = 20
"""Enough for every record to meet every other, and few enough for some thousand inputs a second."""
_LENGTH, _KIND, _MORE, _SEQUENCE, _NS, _REST = 4, 6, 7, 8, 16, 24
"""Where a slot's fields are."""
_SLOTS: Final = 24
"""Where the header says how many there are."""

_LENGTHS: Final = (0, 19, 20, 21, 33, 44, 123, 124, 125, 65_535)
_SEQUENCES: Final = (0, 1, 2**32, 2**62, 2**63 - 1, 2**63, 2**64 - 1)
_TIMES: Final = (-(2**63), -1, 0, 1, 10**9, 5 * 10**9, 30 * 10**9, 2**62 - 1, 2**62, 2**63 - 1)
_BYTES: Final = (0, 1, 18, 19, 31, 63, 127, 128, 192, 254, 255)

Mutate = Callable[[bytes, int], bytes]


def image_of(data: bytes) -> bytes:
    """The file."""
    return data[1:BODY].ljust(form.HEADER_BYTES, b"\0") + data[BODY:] if len(data) >= BODY else data[1:]


def input_of(image: bytes, options: int = 0) -> bytes:
    """The input that makes this file."""
    return bytes((options,)) + image[:HEAD] + image[form.HEADER_BYTES :]


class _Image:
    """An input in its parts."""

    def __init__(self, data: bytes, chance: random.Random, mutate: Mutate) -> None:
        self.chance = chance
        self.mutate = mutate
        self.options = data[0]
        self.head = bytearray(data[1:BODY].ljust(HEAD, b"\0"))
        self.slots = [bytearray(data[at : at + form.SLOT]) for at in range(BODY, len(data), form.SLOT)]
        self.changed: set[int] = set()
        self.torn = b""
        if self.slots and len(self.slots[-1]) < form.SLOT:
            self.torn = bytes(self.slots.pop())

    def data(self) -> bytes:
        return bytes((self.options,)) + self.head + b"".join(self.slots[:MAX_SLOTS]) + self.torn

    def pick(self) -> bytearray:
        """One of the slots, to be changed."""
        place = self.chance.randrange(len(self.slots))
        self.changed.add(place)
        return self.slots[place]

    def fix_checksums(self) -> None:
        for place in self.changed:
            if place < len(self.slots):
                seal(self.slots[place])

    def fix_count(self) -> None:
        struct.pack_into("<I", self.head, _SLOTS, len(self.slots))

    def in_order(self, first: int) -> None:
        """All numbered from `first` on, as a recorder does, each in its place: so the ring wraps around somewhere."""
        count = len(self.slots)
        for place in range(count):
            struct.pack_into("<Q", self.slots[place], _SEQUENCE, first + (place - first) % count)
        self.changed |= set(range(count))


def seal(slot: bytearray) -> None:
    """Put its checksum right, for the length that it says."""
    (length,) = struct.unpack_from("<H", slot, _LENGTH)
    struct.pack_into("<I", slot, 0, crc32(slot[_LENGTH : _LENGTH + length]))


def mutate_ring(data: bytes, max_size: int, seed: int, mutate: Mutate) -> bytes:
    """`data` with some changes; `mutate` is the fuzzer's own way to change bytes."""
    chance = random.Random(seed)  # noqa: S311  a fuzzer wants to be repeatable
    if len(data) < BODY + form.SLOT or chance.random() < 0.02:
        return mutate(data, max_size)
    image = _Image(data, chance, mutate)
    for _ in range(chance.choice((1, 1, 1, 2, 3, 5))):
        if image.slots:
            chance.choice(_CHANGES)(image)
    if chance.random() < 0.95:
        image.fix_count()
    if chance.random() < 0.9:
        image.fix_checksums()
    return image.data()[:max_size]


def cross_rings(one: bytes, other: bytes, max_size: int, seed: int) -> bytes:
    """The first slots of one and the last of the other, mostly numbered as if one gateway had written them."""
    chance = random.Random(seed)  # noqa: S311
    if min(len(one), len(other)) < BODY + form.SLOT:
        return one
    image, more = (_Image(data, chance, lambda data, _: data) for data in (one, other))
    if not image.slots or not more.slots:
        return one
    image.slots = (
        image.slots[: chance.randrange(len(image.slots)) + 1] + more.slots[chance.randrange(len(more.slots)) :]
    )
    del image.slots[MAX_SLOTS:]
    image.fix_count()
    if chance.random() < 0.8:
        image.in_order(chance.randrange(1, 200))
        image.fix_checksums()
    return image.data()[:max_size]


# ---- changes


def _number(image: _Image) -> None:
    slot = image.pick()
    (now,) = struct.unpack_from("<Q", slot, _SEQUENCE)
    count = len(image.slots)
    near = [max(0, now + step) % 2**64 for step in (1, -1, count, -count, 2 * count)]
    struct.pack_into("<Q", slot, _SEQUENCE, image.chance.choice((*near, *_SEQUENCES)))


def _number_all(image: _Image) -> None:
    big = image.chance.choice((2**31, 2**62, 2**63 - 60))
    image.in_order(image.chance.choice((1, 2, image.chance.randrange(1, 300), big)))


def _length(image: _Image) -> None:
    slot = image.pick()
    (now,) = struct.unpack_from("<H", slot, _LENGTH)
    struct.pack_into("<H", slot, _LENGTH, image.chance.choice((*_LENGTHS, (now + 1) % 2**16, max(0, now - 1))))


def _kind(image: _Image) -> None:
    image.pick()[_KIND] = image.chance.choice((*range(form.CARRIED_OUT + 2), 99, 255))


def _more(image: _Image) -> None:
    image.pick()[_MORE] = image.chance.choice((0, 1, 1, 2, 255))


def _chain(image: _Image) -> None:
    """A record that is continued, by as many as there are or a few."""
    first = image.chance.randrange(len(image.slots))
    for place in range(first, min(len(image.slots), first + image.chance.choice((2, 3, 5, MAX_SLOTS)))):
        if place > first:
            image.slots[place][_KIND] = form.MORE
        image.slots[place][_MORE] = 1
        image.changed.add(place)
    image.slots[place][_MORE] = image.chance.randrange(2)


def _time(image: _Image) -> None:
    slot = image.pick()
    (now,) = struct.unpack_from("<q", slot, _NS)
    step = image.chance.choice((1, -1, 15_000_000, -(10**9), 5 * 10**9, 11 * 10**9))
    wanted = image.chance.choice((*_TIMES, now + step, now + step))
    struct.pack_into("<q", slot, _NS, min(max(wanted, -(2**63)), 2**63 - 1))


def _byte(image: _Image) -> None:
    slot = image.pick()
    place = image.chance.randrange(form.SLOT)
    slot[place] = image.chance.choice((slot[place] ^ (1 << image.chance.randrange(8)), *_BYTES))


def _content(image: _Image) -> None:
    """Near its beginning, where numbers and the lengths of texts are."""
    slot = image.pick()
    for _ in range(image.chance.choice((1, 2, 4))):
        slot[_REST + min(int(image.chance.expovariate(0.06)), form.ROOM - 1)] = image.chance.choice(_BYTES)


def _content_anyhow(image: _Image) -> None:
    slot = image.pick()
    (length,) = struct.unpack_from("<H", slot, _LENGTH)
    end = min(max(_LENGTH + length, _REST + 1), form.SLOT)
    made = image.mutate(bytes(slot[_REST:end]), form.ROOM)[: form.ROOM]
    slot[_REST : _REST + len(made)] = made
    struct.pack_into("<H", slot, _LENGTH, _REST - _LENGTH + len(made))


def _swap(image: _Image) -> None:
    one, other = image.pick(), image.pick()
    one[:], other[:] = bytes(other), bytes(one)


def _copy(image: _Image) -> None:
    one, other = image.pick(), image.pick()
    (sequence,) = struct.unpack_from("<Q", one, _SEQUENCE)
    one[:] = other
    if image.chance.random() < 0.7:
        struct.pack_into("<Q", one, _SEQUENCE, sequence)


def _cut(image: _Image) -> None:
    begin = image.chance.randrange(len(image.slots))
    del image.slots[begin : begin + image.chance.choice((1, 1, 2, 5, MAX_SLOTS))]
    if image.slots and image.chance.random() < 0.8:
        image.in_order(image.chance.randrange(1, 200))


def _insert(image: _Image) -> None:
    copy = bytearray(image.pick())
    image.slots.insert(image.chance.randrange(len(image.slots) + 1), copy)
    del image.slots[MAX_SLOTS:]
    image.in_order(image.chance.randrange(1, 200))


def _empty(image: _Image) -> None:
    place = image.chance.randrange(len(image.slots))
    image.slots[place][:] = bytes(form.SLOT)
    image.changed.discard(place)


def _tail(image: _Image) -> None:
    """A file that ends within a slot."""
    image.torn = bytes(image.pick()[: image.chance.randrange(form.SLOT)])


def _header(image: _Image) -> None:
    count = len(image.slots)
    struct.pack_into("<I", image.head, _SLOTS, image.chance.choice((0, 1, count - 1, count + 1, 2**31, 2**32 - 1)))
    if image.chance.random() < 0.3:
        image.head[image.chance.randrange(HEAD)] = image.chance.choice(_BYTES)


def _options(image: _Image) -> None:
    image.options = image.chance.randrange(256)


_CHANGES: Final[tuple[Callable[[_Image], None], ...]] = (
    *(_number, _number_all, _length, _kind, _more, _chain, _time, _time, _byte, _content, _content, _content_anyhow),
    *(_content_anyhow, _swap, _copy, _cut, _insert, _empty, _tail, _header, _options),
)
