"""An slcan adapter with a simulated power board behind it, on a pseudo terminal, served by a thread."""

import os
import select
import threading
import time
import tty
from contextlib import suppress

from gateway.model.power_board import CanFrame
from gateway.robot.power.simulated_board import SimulatedBoard

TICK_MS = 1


class Adapter:
    """Serves until `unplug`; with `path` a new one takes the place of another, as a cable that is plugged in again."""

    def __init__(self, link: str) -> None:
        """`link`: the path that leads to the terminal."""
        self.received: list[bytes] = []
        """Lines from the program, without their end."""
        self.each_tick = b""
        """Bytes for the program, each millisecond: a flood."""
        self.board = SimulatedBoard(time.monotonic_ns())
        self.silent = False
        """The board's cable is out."""
        self._ours, self._theirs = os.openpty()
        tty.setraw(self._theirs)
        os.symlink(os.ttyname(self._theirs), link + ".new")
        os.replace(link + ".new", link)
        self._ends = threading.Event()
        self._reads = threading.Event()
        self._reads.set()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def unplug(self) -> None:
        self._ends.set()
        self._thread.join()
        os.close(self._theirs)
        os.close(self._ours)

    def pause(self) -> None:
        """Read nothing any more."""
        self._reads.clear()

    def go_on(self) -> None:
        self._reads.set()

    def say(self, data: bytes) -> None:
        """Bytes for the program."""
        self._write(data)

    def _serve(self) -> None:
        os.set_blocking(self._ours, False)
        left = b""
        while not self._ends.is_set():
            self._reads.wait()
            if select.select([self._ours], [], [], TICK_MS / 1000)[0]:
                *lines, left = (left + os.read(self._ours, 65536)).split(b"\r")
                for line in lines:
                    self.received.append(line)
                    if line[:1] == b"t" and not self.silent:
                        self._answer(CanFrame(int(line[1:4], 16), bytes.fromhex(line[5:].decode())))
            now_ns = time.monotonic_ns()
            self._write(b"".join(map(_line, [] if self.silent else self.board.advance(now_ns))) + self.each_tick)

    def _answer(self, frame: CanFrame) -> None:
        self._write(b"".join(map(_line, self.board.take(frame, time.monotonic_ns()))))

    def _write(self, data: bytes) -> None:
        with suppress(BlockingIOError):  # as a USB adapter whose host does not read
            os.write(self._ours, data)


def _line(frame: CanFrame) -> bytes:
    return f"t{frame.id:03X}{len(frame.data)}{frame.data.hex().upper()}\r".encode()
