"""`python -m gateway.simulation.board_port JSON`: a simulated power board behind slcan, in a process of its own.

Its first line on stdout is the path of a serial device, for python-can's `slcan`. The argument has these fields, each
with a default: `outputs` (the servo on each output), `page` and `sensed` (descriptors of the pages about simulated
servos and a simulated body), `folder` (contains the device's path; removed at the end), `record` (a file, see below).
The process ends with its standard input, on which lines of JSON are faults:

| line                                   | what happens                                     |
|----------------------------------------|--------------------------------------------------|
| `{"silent": true}`                     | no frame passes between board and adapter        |
| `{"frame": "t06A3000000"}`             | another node puts this frame on the bus          |
| `{"flood_hz": 8000, "flood": "t1000"}` | and this one 8000 times a second; 0: no more     |

The record has a line for each frame that the adapter receives (`<`) or sends (`>`), and for each change of the outputs
with supply (`=`, a mask). A line begins with nanoseconds of CLOCK_MONOTONIC.
"""

import json
import os
import select
import shutil
import signal
import sys
import tempfile
import time
import tty
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Final, TextIO

from gateway.host.shared_page import SensedPage, ServoPage
from gateway.model.power_board import CanFrame
from gateway.model.servo import A_PER_NM, IDLE_A, MOVING_A, NO_LOAD_DEG_S
from gateway.simulation.board import SimulatedBoard
from schemas.robot import SERVO_IDS

OK: Final = b"\r"
ERROR: Final = b"\a"
_LONGEST: Final = 32
"""Bytes of a line; T with 8 bytes of data has 26."""


class SimulatedAdapter:
    """A CAN adapter that speaks slcan on a serial line; its channel is closed at first.

    | line          | answer | does                                                       |
    |---------------|--------|------------------------------------------------------------|
    | S0-S8, sXXXX  | `\\r`  | sets the bit rate, while the channel is closed             |
    | O             | `\\r`  | opens the channel                                          |
    | C             | `\\r`  | closes it                                                  |
    | tIIILDD…      | `\\r`  | puts a frame on the bus                                    |
    | r, T, R       | `\\r`  | frames of other kinds, which the power board does not take |
    | nothing       | `\\r`  |                                                            |
    | anything else | `\\a`  | also a line that is not allowed now                        |

    While the channel is open, each frame on the bus leaves as `tIIILDD…\\r`.
    """

    def __init__(self) -> None:
        self._open = False
        self._line = b""

    def take(self, data: bytes) -> tuple[list[CanFrame], bytes]:
        """Receive bytes from the client. Return the frames for the bus, and the answer to the client."""
        frames: list[CanFrame] = []
        *lines, rest = (self._line + data).split(OK)
        self._line = rest[:_LONGEST]
        return frames, b"".join([self._obey(line[:_LONGEST], frames) for line in lines])

    def text(self, frame: CanFrame) -> bytes:
        """Return the bytes that the client gets for a frame on the bus; none while the channel is closed."""
        return text_of(frame) if self._open else b""

    def _obey(self, line: bytes, frames: list[CanFrame]) -> bytes:
        command = line[:1]
        if command == b"C" or (command == b"O" and not self._open):
            self._open = command == b"O"
        elif command == b"t" and self._open and (frame := frame_of(line)):
            frames.append(frame)
        elif command not in ((b"T", b"r", b"R") if self._open else (b"S", b"s")) and line:
            return ERROR
        return OK


def text_of(frame: CanFrame) -> bytes:
    """Return the frame as `tIIILDD…` and a carriage return."""
    return b"t%03X%d%s\r" % (frame.id, len(frame.data), frame.data.hex().upper().encode())


def frame_of(line: bytes) -> CanFrame | None:
    """Return the frame of a line `tIIILDD…`; None for any other line."""
    try:
        identifier, length, data = int(line[1:4], 16), int(line[4:5]), bytes.fromhex(line[5:].decode("ascii"))
    except ValueError:
        return None
    if not (line[:1] == b"t" and 0 <= identifier <= 0x7FF and len(data) == length <= 8 and len(line) == 5 + 2 * length):
        return None
    return CanFrame(identifier, data)


WAITS_MA: Final = 8.0
HOLDS_MA: Final = 200.0
"""A servo's share while the robot stands. Above the limit for a servo at rest, so a holding servo is noticed."""


class SimulatedDraw:
    """Simulates the servos' currents. Times are of one monotonic clock."""

    def __init__(self) -> None:
        self._sent_deg: dict[int, float | None] = dict.fromkeys(SERVO_IDS)
        self._arrives_ns = dict.fromkeys(SERVO_IDS, 0)

    def draw_ma(
        self, sent_deg: Mapping[int, float | None], torques_nm: Sequence[float], now_ns: int
    ) -> dict[int, float]:
        """Return the current of each servo, by id, with these targets (None: off).

        `torques_nm`: a simulated body's, in the order of SERVO_IDS; empty without a body.
        """
        drawn = {}
        for place, servo_id in enumerate(SERVO_IDS):
            angle_deg, before_deg = sent_deg[servo_id], self._sent_deg[servo_id]
            if angle_deg is not None and angle_deg != before_deg:
                way_deg = abs(angle_deg - (90.0 if before_deg is None else before_deg))
                self._arrives_ns[servo_id] = now_ns + round(way_deg / NO_LOAD_DEG_S * 1e9)
            if angle_deg is None:
                drawn[servo_id] = WAITS_MA
            elif torques_nm:
                drawn[servo_id] = 1000 * (IDLE_A + A_PER_NM * abs(torques_nm[place]))
            else:
                drawn[servo_id] = HOLDS_MA + (1000 * MOVING_A if now_ns < self._arrives_ns[servo_id] else 0.0)
            self._sent_deg[servo_id] = angle_deg
        return drawn


NS_PER_S: Final = 1_000_000_000
_MOST_UNSENT: Final = 4096
"""Bytes kept for a client that does not read; further frames are lost, as in an adapter."""
_MOST_READ: Final = 4096
_MOST_AT_ONCE: Final = 500
"""Frames of a flood that are sent at once after this process was delayed."""


class Device:
    """The adapter's end of a serial line. `link` leads to the client's end."""

    def __init__(self, link: Path) -> None:
        self.fd, self._theirs = os.openpty()
        tty.setraw(self._theirs)  # stays open here, so that this end survives each client
        os.set_blocking(self.fd, False)
        link.symlink_to(os.ttyname(self._theirs))
        self.unsent = b""

    def read(self) -> bytes:
        """Return the bytes that the client has sent; none if there are none. Never waits."""
        try:
            return os.read(self.fd, _MOST_READ)
        except BlockingIOError:
            return b""

    def write(self, data: bytes) -> None:
        """Send `data`, or drop all of it if too many bytes wait for the client. Never waits."""
        if len(self.unsent) + len(data) <= _MOST_UNSENT:
            self.unsent += data
        with suppress(BlockingIOError):
            self.unsent = self.unsent[os.write(self.fd, self.unsent) :]


class Simulation:
    """The board, the adapter, the bus between them, and the servos that the board supplies."""

    def __init__(self, options: dict[str, Any], device: Device, record: TextIO) -> None:
        self._outputs: tuple[int, ...] = tuple(options.get("outputs") or SERVO_IDS)
        self._page = ServoPage(options.get("page"))
        self._sensed = None if options.get("sensed") is None else SensedPage(options["sensed"])
        self._record = record
        self._device = device
        self._board = SimulatedBoard(time.monotonic_ns())
        self._adapter = SimulatedAdapter()
        self._silent = False
        self._draw = SimulatedDraw()
        self._fed: int | None = None
        self._flood, self._flood_ns, self._flood_due_ns = CanFrame(0x100), 0, 0
        self.step()

    def step(self) -> int:
        """Do all that is due. Return when the next call is due, in ns of CLOCK_MONOTONIC."""
        now_ns = time.monotonic_ns()
        frames, answers = self._adapter.take(self._device.read())
        self._device.write(answers)
        sensed = None if self._sensed is None else self._sensed.read()
        drawn_ma = self._draw.draw_ma(self._page.read(), () if sensed is None else sensed.torques_nm, now_ns)
        self._board.draws_ma[:] = [drawn_ma[servo_id] for servo_id in self._outputs]
        for frame in frames:
            self._note("<", frame, now_ns)
            if not self._silent:
                self._answer(self._board.take(frame, now_ns), now_ns)
        if self._flood_ns:
            self._flood_due_ns = max(self._flood_due_ns, now_ns - _MOST_AT_ONCE * self._flood_ns)
            while self._flood_due_ns <= now_ns:
                self._put(self._flood, now_ns)
                self._flood_due_ns += self._flood_ns
        self._answer(self._board.advance(now_ns), now_ns)
        if (fed := self._board.fed) != self._fed:
            self._fed = fed
            self._page.feed({servo_id for place, servo_id in enumerate(self._outputs) if fed >> place & 1})
            self._record.write(f"{now_ns} = {fed:06x}\n")
        return min(self._board.due_ns, self._flood_due_ns) if self._flood_ns else self._board.due_ns

    def do(self, line: bytes) -> None:
        """Apply a line of faults, as in the table above. Raises ValueError or TypeError for others."""
        now_ns = time.monotonic_ns()
        order: dict[str, Any] = json.loads(line)
        for name, value in order.items():
            match name:
                case "silent":
                    self._silent = bool(value)
                case "frame":
                    self._put(_frame(value), now_ns)
                case "flood":
                    self._flood = _frame(value)
                case "flood_hz":
                    self._flood_ns, self._flood_due_ns = round(NS_PER_S / value) if value else 0, now_ns
                case _:
                    raise ValueError(f"{name} is no fault")
        self.step()

    def _put(self, frame: CanFrame, now_ns: int) -> None:
        """Put another node's frame on the bus."""
        self._pass_on(frame, now_ns)
        self._answer(self._board.take(frame, now_ns), now_ns)

    def _answer(self, frames: Sequence[CanFrame], now_ns: int) -> None:
        for frame in () if self._silent else frames:
            self._pass_on(frame, now_ns)

    def _pass_on(self, frame: CanFrame, now_ns: int) -> None:
        self._note(">", frame, now_ns)
        self._device.write(self._adapter.text(frame))

    def _note(self, way: str, frame: CanFrame, now_ns: int) -> None:
        self._record.write(f"{now_ns} {way} {text_of(frame).decode().rstrip()}\n")


def _frame(text: str) -> CanFrame:
    frame = frame_of(text.encode())
    if frame is None:
        raise ValueError(f"{text} is no frame; write it as t06A3000000")
    return frame


def serve(options: dict[str, Any], folder: Path, record: TextIO) -> None:
    """Simulate, with the device in `folder`, until standard input ends."""
    device = Device(folder / "can")
    simulation = Simulation(options, device, record)
    sys.stdout.write(f"{folder / 'can'}\n")
    sys.stdout.flush()
    orders, received = sys.stdin.fileno(), b""
    due_ns = simulation.step()
    while True:
        wait_s = max(0, due_ns - time.monotonic_ns()) / NS_PER_S
        readable, _, _ = select.select([orders, device.fd], [device.fd] if device.unsent else [], [], wait_s)
        if orders in readable:
            data = os.read(orders, _MOST_READ)
            if not data:
                return
            *lines, received = (received + data).split(b"\n")
            for order in lines:
                try:
                    simulation.do(order)
                except (ValueError, TypeError) as error:
                    sys.stderr.write(f"power board: {order.decode(errors='replace')}: {error}\n")
        due_ns = simulation.step()


def main(arguments: Sequence[str]) -> int:
    """Simulate until the gateway ends, or SIGTERM; then remove the folder. Return exit code 0.

    SIGINT, SIGQUIT and SIGHUP are ignored: they are for the gateway.
    """
    for number in (signal.SIGINT, signal.SIGQUIT, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda number, _: sys.exit(128 + number))
    options: dict[str, Any] = json.loads(arguments[0]) if arguments else {}
    folder = Path(options.get("folder") or tempfile.mkdtemp(prefix="hexapod-power-"))
    try:
        with open(options.get("record") or os.devnull, "a", buffering=1) as record:
            serve(options, folder, record)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
