"""Scenes for the SPI bus: what is done, and which calls the device then gets.

A call is written as its zeros (`16z`), a leg's number for its Stop, `s` for servo 11's, `m` for a frame that moves, and
`a` for an announcement alone.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from typing import Final, TypeVar

from gateway.errors import BatchRejectedError, SpiError
from gateway.host.settings_table import SpiSettings
from gateway.model.frames import STOP, ZERO, Frame, Framing, OneLeg, OneServo, Op, ServoOp, stop_leg
from gateway.robot.spi import Batch, BatchReport, SpiDevice
from gateway.robot.spi.bus import CS_CHANGE_NS, Bus
from schemas.robot import LEGS

MS: Final = 1_000_000
MOVES: Final = [OneLeg(leg, (ServoOp(Op.SET, 90_00),) * 3) for leg in LEGS]
STOPS: Final = [stop_leg(leg) for leg in LEGS]
STOP_SERVO: Final = OneServo(11, STOP)
SIGNS: Final = {ZERO: "z", STOP_SERVO.data: "s", **{stop.data: str(leg) for leg, stop in zip(LEGS, STOPS, strict=True)}}


def wire_ns(batch: Batch) -> int:
    """Return the time from the first bit to the last, as the emulated device counts it."""
    return sum(3200 * len(data) + pause_us * 1000 + CS_CHANGE_NS for data, pause_us in batch) - (
        batch[-1][1] * 1000 + CS_CHANGE_NS
    )


class Bench(SpiDevice):
    """A device whose calls fail where a scene says so, the synchronised bus above it, and a clock that they move."""

    def __init__(
        self,
        framing: Framing = Framing.LENGTH_PREFIXED,
        *,
        frame_gap_us: float = 50,
        most_transfers: int = 32,
        synchronised: bool = True,
    ) -> None:
        self.now_ns = 7_000 * MS
        self.most_transfers = most_transfers
        self.batches: list[Batch] = []
        """The batches that were written, or failed."""
        self.calls: list[str] = []
        """The calls in words since a scene last read them."""
        self.fails: Callable[[int, str], bool] = lambda _number, _call: False
        """Returns whether a call fails, by its number since this was set, and its words."""
        self.failure_ns = 0
        self.wire_takes_time = False
        """A call that succeeds takes what the wire needs."""
        self.stall_ns = self.pause_stall_ns = 0
        """How much longer the next call, or the next pause, takes."""
        self.takes_lists = True
        self.meddled: str | None = None
        self.looks = self.openings = self.open_now = 0
        self.report = BatchReport()
        self.more = False
        self._count = 0
        self.bus = Bus(
            SpiSettings(speed_hz=2_500_000, framing=framing, frame_gap_us=frame_gap_us),
            self.open,
            clock=lambda: self.now_ns,
            pause=self.pause,
        )
        if synchronised:
            self.bus.open()
            self.bus.write(MOVES[:1])
        self.forget()

    def forget(self) -> None:
        self.batches.clear()
        self.calls.clear()
        self.looks = 0

    # ---- the device

    def open(self) -> "Bench":
        self.openings += 1
        self.open_now += 1
        return self

    def transfer(self, batch: Batch) -> None:
        words = "".join(SIGNS.get(data, "m") for data, _ in batch if len(data) > 1 or data == ZERO)
        call = re.sub("z{2,}", lambda zeros: f"{len(zeros[0])}z", words) or "a"
        self._count += 1
        failed = self.fails(self._count, call)
        if not failed and len(batch) > 1 and not self.takes_lists:
            raise BatchRejectedError("no lists here")
        self.batches.append(tuple(batch))
        self.calls.append(call)
        wire = wire_ns(batch) + batch[-1][1] * 1000 if self.wire_takes_time and not failed else 0
        self.now_ns += self.stall_ns + wire + (self.failure_ns if failed else 0)
        self.stall_ns = 0
        if failed:
            raise SpiError(f"{call} failed")

    def close(self) -> None:
        self.open_now -= 1

    def pause(self, duration_s: float) -> None:
        self.now_ns += round(duration_s * 1e9) + self.pause_stall_ns
        self.pause_stall_ns = 0

    def put_right(self) -> str | None:
        self.looks += 1
        found, self.meddled = self.meddled, None
        return found

    # ---- what was written

    @property
    def sizes(self) -> list[int]:
        return [len(batch) for batch in self.batches]

    @property
    def written(self) -> list[bytes]:
        """Return all transfers, however they are split."""
        return [data for batch in self.batches for data, _ in batch]

    @property
    def frames(self) -> list[bytes]:
        """Return the frames among them, whatever announces them."""
        return [data for data in self.written if len(data) > 1]

    def play(self, scene: str) -> "Bench":
        return play(self, scene, DONE, Bench._made, FACTS)

    def _made(self) -> list[str]:
        calls, self.calls = self.calls, []
        return calls

    def write(self, frames: Sequence[Frame], *, preamble: bool = False) -> None:
        self.report = self.bus.write(frames, preamble=preamble)


def _fail(bench: Bench, words: str) -> None:
    """Let calls fail: `fail 1 3`, counted from now; `fail with 1`: each with this in it; `fail all`, `fail none`."""
    what, _, sign = words.partition(" ")
    if what in ("with", "all", "none"):
        bench.fails = lambda _, call: what == "all" or (what == "with" and sign in call)
        return
    failing, bench._count = frozenset(map(int, words.split())), 0
    bench.fails = lambda number, _: number in failing


def _stops(legs: str) -> list[OneLeg]:
    return [stop_leg(int(leg)) for leg in legs.replace(" ", "")] or STOPS


def _set(name: str, value: Callable[[str], object]) -> Callable[[Bench, str], None]:
    return lambda bench, words: setattr(bench, name, value(words))


def _ns(ms: str) -> int:
    return round(float(ms) * MS)


DONE: Final[dict[str, Callable[[Bench, str], object]]] = {
    "stop": lambda bench, legs: bench.write(_stops(legs)),
    "repeat": lambda bench, legs: bench.write(_stops(legs), preamble=True),
    "servo": lambda bench, legs: bench.write([*(stop_leg(int(leg)) for leg in legs), STOP_SERVO]),
    "move": lambda bench, _: bench.write(MOVES[:1]),
    "moves": lambda bench, _: bench.write(MOVES),
    "zeros": lambda bench, _: setattr(bench, "more", bench.bus.write_zeros()),
    "open": lambda bench, _: bench.bus.open(),
    "close": lambda bench, _: bench.bus.close(),
    "wait": lambda bench, ms: setattr(bench, "now_ns", bench.now_ns + _ns(ms)),
    "fail": _fail,
    "failing-takes": _set("failure_ns", _ns),
    "stalls": _set("stall_ns", _ns),
    "lists": _set("takes_lists", lambda word: word == "on"),
    "meddled": _set("meddled", str),
}

FACTS: Final[dict[str, Callable[[Bench], object]]] = {
    "fault": lambda bench: bench.report.fault,
    "rejection": lambda bench: bench.report.rejection,
    "found": lambda bench: bench.report.meddled,
    "sent": lambda bench: "".join(
        str(place + 1) + "?" * (not sent.received) for sent in bench.report.sent for place in sent.places
    ),
    "errors": lambda bench: bench.bus.errors,
    "due": lambda bench: bench.bus.resync_due,
    "more": lambda bench: bench.more,
    "whole": lambda bench: bench.bus.just_resynchronised,
    "looks": lambda bench: bench.looks,
}
"""The facts, by their first word; `sent 6?54`: the places of what was sent, `?` where it may not have arrived."""


T = TypeVar("T")
FAULT: Final = "fault"
"""The fact of which a scene has a part; of the others it has all."""


def play(
    subject: T,
    scene: str,
    done: Mapping[str, Callable[[T, str], object]],
    made: Callable[[T], list[str]],
    facts: Mapping[str, Callable[[T], object]],
) -> T:
    """Play each line of a scene. `made`: the words since it was last called."""
    for line in filter(None, map(str.strip, scene.splitlines())):
        actions, arrow, expected = line.partition("  #")[0].partition("→")
        for each in actions.split(";"):
            word, _, rest = each.strip().partition(" ")
            done[word](subject, rest)
        if not arrow:
            continue
        wanted, *others = (each.strip() for each in expected.split(";"))
        words, more, _ = wanted.replace("nothing", "").partition("…")
        found = made(subject)
        assert (found[: len(words.split())] if more else found) == words.split(), f"{line}: {found}"
        for fact in others if any(each.startswith(FAULT) for each in others) else (*others, f"{FAULT} None"):
            word, _, text = fact.partition(" ")
            is_so = str(facts[word](subject))
            assert text in is_so if word == FAULT else text == is_so, f"{line}: {fact}, but {is_so}"
    return subject
