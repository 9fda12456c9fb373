"""Each byte of a minute lost once, each gap stretched once: what becomes of it on the simulated controller."""

import copy
import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field

from gateway.robot.protocol.framing import ZERO, Framing
from gateway.robot.spi.simulator import SimulatedController
from tests.deaf.minute import minute
from tests.deaf.scene import BEGIN_NS, MS, Scene, Written
from tests.deaf.watcher import State, Watcher, pulses

END_NS = BEGIN_NS + 60_500 * MS
AFTER_NS = 2_000 * MS
"""How long a scene is watched after a stall: twice what a stream may take."""
STALLS_MS = (900, 1100, 3000)
_SOME_BYTES = re.compile(r"^\d+ bytes in ")


@dataclass(slots=True)
class Tally:
    """What became of some faults."""

    faults: int = 0
    without_effect: int = 0
    missed: int = 0
    most_missed: int = 0
    """Frames of one fault."""
    missed_first_stops: int = 0
    stops_after_repeat: list[str] = field(default_factory=list)
    """Where a Stop was not executed even with its first repeat: nowhere."""
    left_on: list[str] = field(default_factory=list)
    """Where a servo was on in the end that the gateway takes as stopped: nowhere."""
    deaf_ms: float = 0.0
    deaf_longest: str = ""
    corruptions: int = 0
    dead: Counter[str] = field(default_factory=Counter)
    """What the controller died of, and how often."""
    unasked: Counter[str] = field(default_factory=Counter)
    unasked_ms: dict[str, list[float]] = field(default_factory=dict)

    def add(self, where: str, place: str, watcher: Watcher) -> None:
        """A fault that has been watched to its end; `place` is what it hit."""
        self.faults += 1
        self.without_effect += not (watcher.missed or watcher.unasked)
        self.missed += watcher.missed
        self.most_missed = max(self.most_missed, watcher.missed)
        self.missed_first_stops += watcher.missed_first_stops
        if watcher.stops_after_repeat:
            self.stops_after_repeat.append(f"{where}: {watcher.stops_after_repeat[:3]}")
        if watcher.deaf_ns / MS > self.deaf_ms:
            self.deaf_ms, self.deaf_longest = watcher.deaf_ns / MS, where
        for _, what, duration_ns in watcher.unasked:
            self.unasked_ms.setdefault(f"{what}, {place}", []).append(duration_ns / MS)
        self.unasked.update({f"{what}, {place}" for _, what, _ in watcher.unasked})

    @property
    def text(self) -> str:
        lines = [
            f"{self.faults} faults, {self.without_effect} without effect",
            f"  frames missed {self.missed} (at most {self.most_missed} of a fault),"
            f" of them first Stops {self.missed_first_stops}, repeated Stops {len(self.stops_after_repeat)}",
            f"  longest deaf {self.deaf_ms:.0f} ms ({self.deaf_longest}); servos left on {len(self.left_on)};"
            f" corruptions {self.corruptions}; controllers dead {self.dead.total()}",
        ]
        for what, count in sorted(self.unasked.items()):
            times_ms = sorted(self.unasked_ms[what])
            lines.append(
                f"  {what}: {count} faults, {len(times_ms)} servos,"
                f" for {times_ms[len(times_ms) // 2]:.0f} ms (median), {times_ms[-1]:.0f} ms (longest)"
            )
        lines += [f"  dead: {why}, {count} faults" for why, count in self.dead.most_common(5)]
        return "\n".join([*lines, *self.stops_after_repeat[:5], *self.left_on[:5]])


class _Clock:
    now_ns = BEGIN_NS

    def __call__(self) -> int:
        return self.now_ns


def recorded() -> list[Written]:
    """The minute as it was written, without a fault."""
    scene = Scene(minute())
    scene.run_until(END_NS)
    return scene.log


def lose_bytes(
    log: list[Written], *, every: int = 1, first: int = 0, tick_phase_ns: int = 0, doubled: bool = False
) -> Tally:
    """Lose each byte once, or double it; with `every`, one in so many."""
    clock, tally = _Clock(), Tally()
    controller = SimulatedController(Framing.LENGTH_PREFIXED, clock=clock, tick_phase_ns=tick_phase_ns)
    watcher = Watcher(controller)
    states = _states(log, clock, copy.deepcopy(controller, {id(clock): clock}))
    number = 0
    for index, written in enumerate(log):
        clock.now_ns = written.at_ns
        for position in range(len(written.data)):
            number += 1
            if (number - first) % every:
                continue
            controller.transfers.clear()
            faulty: Watcher = copy.deepcopy(watcher, {id(clock): clock})
            faulty.fault_ns = written.at_ns
            spoilt = written.data[: position + doubled] + written.data[position + (not doubled) :]
            _play_on(log, index, spoilt, states, clock, faulty)
            if faulty.controller.dead is not None:
                tally.dead[_SOME_BYTES.sub("", faulty.controller.dead)] += 1
            tally.corruptions += faulty.controller.corruptions.total()
            tally.add(
                f"byte {position} of [{written.data.hex()}], transfer {index}",
                _place(written.data, doubled=doubled),
                faulty,
            )
            clock.now_ns = written.at_ns
        controller.take(written.data)
        watcher.saw(written.at_ns, written.data, repeat=written.repeat)
    assert not watcher.missed, "without a fault, all is executed"
    return tally


def _place(data: bytes, *, doubled: bool) -> str:
    fault = "doubled" if doubled else "lost"
    return f"a zero {fault}" if data == ZERO else f"an announcement {fault}" if len(data) == 1 else f"of a body {fault}"


def _states(log: list[Written], clock: _Clock, controller: SimulatedController) -> list[State]:
    """The servos after each transfer."""
    states: list[State] = []
    for written in log:
        clock.now_ns = written.at_ns
        executed = controller.executed
        controller.take(written.data)
        states.append(pulses(controller) if controller.executed > executed or not states else states[-1])
    return states


def _play_on(
    log: list[Written], index: int, spoilt: bytes, states: list[State], clock: _Clock, watcher: Watcher
) -> None:
    """Play the rest with that transfer spoilt, until nothing is left of the fault, or of the controller."""
    controller = watcher.controller
    for place in range(index, len(log)):
        at_ns, data, repeat = log[place]
        clock.now_ns = at_ns
        controller.take(data if place > index else spoilt)
        if controller.dead is not None:
            break
        watcher.saw(at_ns, data, repeat=repeat)
        if len(data) > 1 and not controller.missing and not watcher.astray and pulses(controller) == states[place]:
            break
    watcher.end(clock.now_ns)


def stretch_gaps(
    *,
    every: int = 1,
    first: int = 0,
    stalls_ms: tuple[float, ...] = STALLS_MS,
    tick_phase_ns: int = 0,
) -> dict[float, Tally]:
    """Let the machine stall once before each call of the minute; with `every`, before one in so many.

    Within a call it cannot: the transfers of a call leave together.
    """
    tallies = {stall_ms: Tally() for stall_ms in stalls_ms}
    for before, number in _moments(every, first, tick_phase_ns):
        for stall_ms, tally in tallies.items():
            scene = before.copy()
            scene.stall_at(number, round(stall_ms * MS))
            scene.run_until(before.loop.clock_ns + round(stall_ms * MS) + AFTER_NS)
            scene.watcher.end(scene.loop.clock_ns)
            where = f"transfer {number}"
            tally.add(where, "after a stall", scene.watcher)
            tally.corruptions += scene.controller.corruptions.total()
            running = {servo.servo_id for servo in scene.conductor.supervisor.legs.servos.values() if servo.running}
            if not scene.controller.energised <= running:
                tally.left_on.append(f"{where}: {sorted(scene.controller.energised - running)}")
    return tallies


def _moments(every: int, first: int, tick_phase_ns: int) -> Iterator[tuple[Scene, int]]:
    """A scene just before the step whose call begins with the transfer of that number, for each that is wanted.

    The minute is always the same, so a first run of it says which steps those are; a copy takes longer than a step.
    """
    ahead, scene = (Scene(minute(), tick_phase_ns=tick_phase_ns) for _ in range(2))
    calls = 0
    while ahead.loop.clock_ns < END_NS:
        ahead.calls.clear()
        if not ahead.step():
            break
        wanted = [number for place, number in enumerate(ahead.calls, calls) if (place - first) % every == 0]
        calls += len(ahead.calls)
        if wanted:
            before = scene.copy()
            yield from ((before, number) for number in wanted)
        scene.step()
