"""An slcan adapter with a simulated power board behind it, on a pseudo terminal, served by a thread."""

import os
import select
import threading
import time
import tty
from contextlib import suppress

from gateway.simulation.board import SimulatedBoard
from gateway.simulation.board_port import SimulatedAdapter

TICK_MS = 1


class Adapter:
    """Serves until `unplug`."""

    def __init__(self, link: str) -> None:
        """`link`: the path that leads to the terminal."""
        self.board = SimulatedBoard(time.monotonic_ns())
        self.received: list[bytes] = []
        """The program's lines."""
        self._ours, self._theirs = os.openpty()
        tty.setraw(self._theirs)
        os.symlink(os.ttyname(self._theirs), link)
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

    def _serve(self) -> None:
        os.set_blocking(self._ours, False)
        adapter = SimulatedAdapter()
        while not self._ends.is_set():
            self._reads.wait()
            if select.select([self._ours], [], [], TICK_MS / 1000)[0]:
                data = os.read(self._ours, 65536)
                self.received += data.split(b"\r")[:-1]
                frames, answers = adapter.take(data)
                self.say(answers)
                for frame in frames:
                    self.say(b"".join(map(adapter.text, self.board.take(frame, time.monotonic_ns()))))
            self.say(b"".join(map(adapter.text, self.board.advance(time.monotonic_ns()))))

    def say(self, data: bytes) -> None:
        """Bytes for the program."""
        with suppress(BlockingIOError):  # as a USB adapter whose host does not read
            os.write(self._ours, data)
