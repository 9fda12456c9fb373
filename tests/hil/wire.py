"""What a test expects on the emulated wire, in the gateway's framing, and what a controller makes of it."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Self

import pytest

from gateway.model.frames import STOP, STOP_REPEATS, ZERO, Framing, OneLeg, OneServo, Op, ServoOp, decode, stop_leg
from schemas.robot import LEGS, SERVO_IDS
from tests.hil.bed import SpiTestbed, Transfer
from tests.support.child import Child
from tests.support.controllers import Controller, on_wire, preamble_of
from tests.support.gateway_process import COMMAND, Gateway

STOPS = [stop_leg(leg).data.hex() for leg in LEGS]
"""Stops for all six legs, as every start, end and emergency stop writes them."""
START_3 = "0e011f015a0020012d0021017800"  # leg 3 at 90, 45, 120
QUIET: dict[str, Any] = {"timeout_ms": 10_000}
"""A watchdog that adds nothing to what a test of something else expects."""
STOP_FRAMES = frozenset(
    [stop_leg(leg).data for leg in LEGS] + [OneServo(servo_id, STOP).data for servo_id in SERVO_IDS]
)
EACH_FRAMING = pytest.mark.parametrize("wire", Framing, indirect=True)
"""For what a framing may change: when Stops are written, byte for byte. The rest is the same behind `Framing`."""
LATE_S = 60.0
"""How long a test waits for something that takes milliseconds: a busy machine must not fail it."""


def transfers_of(framing: Framing, *frames: str) -> list[bytes]:
    """Return the transfers that carry these frames (hex), in order."""
    return on_wire(framing, *map(bytes.fromhex, frames))


def opening_of(framing: Framing, *frames: str) -> list[bytes]:
    """Return those transfers after the preamble: from a device that was just opened, or of a repeated run of Stops."""
    return [*preamble_of(framing), *transfers_of(framing, *frames)]


class Wire:
    """Reads the transfers of one device one after the other: what is not expected fails the test that comes upon it.

    Legs of which no servo runs may get Stops at any time. These are left out where they are not expected.
    """

    def __init__(self, bed: SpiTestbed, framing: Framing = Framing.PLAIN) -> None:
        self.bed = bed
        self.framing = framing
        self._read = 0
        self._on: set[int] = set()
        """The servos that run, by what was read."""

    def expect(self, *frames: str) -> list[Transfer]:
        """Wait for the next frames (hex) with nothing else among them, and return them."""
        return self._expect(transfers_of(self.framing, *frames))

    def expect_opening(self, *frames: str, times: int = 1) -> list[Transfer]:
        """Expect the preamble, if the framing has one, and these frames, so many times."""
        return self._expect(opening_of(self.framing, *frames) * times)

    def _expect(self, expected: list[bytes]) -> list[Transfer]:
        """Return the next transfers, byte for byte, each delivered."""
        found: list[Transfer] = []
        while len(found) < len(expected):
            unit = self._next()
            wanted = expected[len(found) : len(found) + len(unit)]
            if [each.data for each in unit] == wanted or not self._is_by_itself(unit):
                found += unit
            self._follow(unit)
        assert [(each.data.hex(), each.errno) for each in found] == [(data.hex(), 0) for data in expected]
        return found

    def _next(self) -> list[Transfer]:
        """Return the next transfer, and after an announcement the announced frame."""
        transfers = self.bed.wait_for(lambda transfers: len(transfers) > self._read, LATE_S)
        if self._announces(transfers[self._read]):
            transfers = self.bed.wait_for(lambda transfers: len(transfers) > self._read + 1, LATE_S)
        unit = self._units(transfers[self._read :])[0]
        self._read += len(unit)
        return unit

    def _announces(self, transfer: Transfer) -> bool:
        prefixed = self.framing is Framing.LENGTH_PREFIXED and transfer.delivered
        return prefixed and len(transfer.data) == 1 and transfer.data != ZERO

    def _units(self, transfers: Sequence[Transfer]) -> list[list[Transfer]]:
        """Return these transfers, each announcement with its frame."""
        units: list[list[Transfer]] = []
        for transfer in transfers:
            if units and len(units[-1]) == 1 and self._announces(units[-1][0]):
                units[-1].append(transfer)
            else:
                units.append([transfer])
        return units

    def expect_behind_rest(self, *frames: str) -> None:
        """Expect these frames, and before them only the Stops of a robot at rest (*Legs at rest*)."""
        expected, begin = transfers_of(self.framing, *frames), self._read
        self.bed.wait_for(
            lambda transfers: [each.data for each in transfers[begin:]][-len(expected) :] == expected, LATE_S
        )
        before = {each.data for each in self.skip()[: -len(expected)]}
        assert before <= {*opening_of(self.framing, *(data.hex() for data in STOP_FRAMES))}

    def expect_nothing(self) -> None:
        """Check that nothing has come since what was last read. Call it once an answer states that all was written."""
        left = [unit for unit in self._units(self.bed.transfers[self._read :]) if not self._is_by_itself(unit)]
        assert [transfer.data.hex() for unit in left for transfer in unit] == []

    def skip(self) -> list[Transfer]:
        """Return all that has come since what was last read, whatever it is."""
        transfers = self.bed.transfers[self._read :]
        self._read += len(transfers)
        for unit in self._units(transfers):
            self._follow(unit)
        return transfers

    def _is_by_itself(self, unit: list[Transfer]) -> bool:
        """Return whether the gateway writes it without a command: repeats of Stops, and what legs at rest get.
        How long a test takes must not change what it expects.
        """
        data = unit[-1].data
        if data == ZERO:
            return unit[-1].delivered
        return data in STOP_FRAMES and self._on.isdisjoint(servo_id for servo_id, _ in decode(data).servos)

    def _follow(self, unit: list[Transfer]) -> None:
        frame = unit[-1]
        if frame.delivered and len(frame.data) > 1:
            for servo_id, op in decode(frame.data).servos:
                (self._on.discard if op.op is Op.STOP else self._on.add)(servo_id)


def settings_for(wire: Wire, **sections: dict[str, Any]) -> dict[str, dict[str, Any]]:
    spi = {"framing": wire.framing, **sections.pop("spi", {})}
    return {"watchdog": QUIET, **sections, "spi": spi}


def ended(bed: SpiTestbed, command: str, config: Path, env: Mapping[str, str] | None = None) -> Child:
    """Run one of our commands on the device, to its end: a success."""
    child = bed.spawn([*COMMAND, command, "--config", str(config)], env=env)
    assert child.wait(LATE_S) == 0, str(child)
    return child


def start(folder: Path, wire: Wire, **sections: dict[str, Any]) -> Gateway:
    """Return a gateway on the wire, whose start has been read."""
    gateway = Gateway(folder, settings_for(wire, **sections), bed=wire.bed)
    wire.expect_opening(*STOPS, times=1 + 1 + STOP_REPEATS)  # the first come before the service is loaded
    return gateway


class Replay:
    """A simulated controller that is given recorded transfers at the times at which they came.

    `selects`: a controller of the document that takes one frame while chip select is held, and no more.
    """

    def __init__(self, framing: Framing, *, selects: bool = False) -> None:
        self.now_ns = 0
        self._selects = selects
        self.controller = Controller(framing, clock=lambda: self.now_ns)

    def play(self, transfers: Iterable[Transfer]) -> Self:
        """Return what of these was delivered."""
        for transfer in transfers:
            if transfer.delivered:
                self.give(transfer.data, transfer.monotonic_ns)
        return self

    def give(self, data: bytes, now_ns: int) -> None:
        self.now_ns = now_ns
        self.controller.take(data[: data[0]] if self._selects else data)

    def energised_for_good(self) -> frozenset[int]:
        """Return the servos that are on now, or come on when a pending receive is given up, a second after it began."""
        now = self.controller.energised
        self.now_ns += 2_000_000_000
        return now | self.controller.energised


def moving(framing: Framing) -> Replay:
    """Return a controller whose 18 servos are on."""
    replay = Replay(framing)
    for leg in LEGS:
        for data in on_wire(framing, OneLeg(leg, (ServoOp(Op.START, 90_00),) * 3)):
            replay.give(data, 0)
    assert len(replay.controller.energised) == 18
    return replay
