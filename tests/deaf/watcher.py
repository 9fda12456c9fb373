"""Watches what a controller does beside what was written to it: which frames it missed, and what it did unasked."""

import functools
from dataclasses import dataclass, field

from gateway.model.frames import Op, decode
from gateway.simulation.controller import pulse_us
from schemas.robot import SERVO_IDS
from tests.support.controllers import Controller

State = dict[int, int | None]
Said = tuple[Op | None, int | None]


@dataclass(slots=True)
class Watcher:
    """Call `saw` after each transfer. Times in nanoseconds."""

    controller: Controller
    fault_ns: int = 0
    missed: int = 0
    """Frames that were written and not executed as they are."""
    deaf_ns: int = 0
    """From the fault to the last of them."""
    missed_first_stops: int = 0
    misread: bool = False
    """Whether anything was executed since the fault that was not written so: at first, what half a body says."""
    stops_after_repeat: int = 0
    """Servos that were on after a repeated Stop for them: none."""
    left_on: frozenset[int] = frozenset()
    """At the end of all: the servos that only a reset or the supply's switch stops."""
    unasked: set[str] = field(default_factory=set)
    """What servos did that no frame said: started or moved, and by what."""
    _executed: int = 0
    _state: State = field(default_factory=lambda: dict.fromkeys(SERVO_IDS))
    astray: set[int] = field(default_factory=set)
    """Servos that do what no frame said."""

    def saw(self, now_ns: int, data: bytes, *, repeat: bool) -> None:
        """What was written just now."""
        executed, self._executed = self.controller.executed - self._executed, self.controller.executed
        if len(data) == 1 and not executed:
            return
        said = _said(data)
        before, now = self._state, pulses(self.controller)
        self._state = now
        if executed == 1 and not self.astray and now == _after(before, said):
            return
        how = "by half a body" if not self.misread else "out of sync"
        for servo_id in SERVO_IDS:
            self._compare(servo_id, before[servo_id], now[servo_id], said.get(servo_id), how)
        self.misread |= executed > 0
        if said and (executed != 1 or now != _after(before, said)):
            self.missed += 1
            self.deaf_ns = max(self.deaf_ns, now_ns - self.fault_ns)
        if said and all(op is None for op, _ in said.values()):
            on = sum(now[servo_id] is not None for servo_id in said)
            if repeat:
                self.stops_after_repeat += on
            elif on:
                self.missed_first_stops += 1

    def _compare(self, servo_id: int, before: int | None, now: int | None, said: Said | None, how: str) -> None:
        """Whether one servo does what no frame said, or has ended to."""
        op, angle_us = said or (None, None)
        if now is None or (op is not None and now == angle_us and (before is not None or op is Op.START)):
            self.astray.discard(servo_id)
        elif now != before and servo_id not in self.astray:
            self.astray.add(servo_id)
            self.unasked.add(f"{'started' if before is None else 'moved'} {how}")


def pulses(controller: Controller) -> State:
    """The pulse of each servo that is on; None for one that is off, whose compare value nobody sees."""
    servos = controller.servos
    return {servo_id: servos[servo_id].pulse_us if servos[servo_id].energised else None for servo_id in SERVO_IDS}


@functools.cache
def _said(data: bytes) -> dict[int, Said]:
    """What a frame says of its servos: the operation (None: Stop) and the pulse."""
    if len(data) == 1:
        return {}
    return {
        servo_id: (None, None) if op.op is Op.STOP else (op.op, pulse_us(*divmod(op.angle_cdeg, 100)))
        for servo_id, op in decode(data).servos
    }


def _after(before: State, said: dict[int, Said]) -> State:
    """What becomes of the servos as a frame says it; a Set for one that is off is not seen."""
    after = dict(before)
    for servo_id, (op, angle_us) in said.items():
        if op is not Op.SET or before[servo_id] is not None:
            after[servo_id] = angle_us
    return after
