"""An slcan adapter with a simulated power board behind it, on a pseudo terminal, served by a thread."""

import os
import select
import threading
import time
from pathlib import Path

from gateway.simulation.board import SimulatedBoard
from gateway.simulation.board_port import Device, SimulatedAdapter

TICK_MS = 1


class Adapter(Device):
    """Serves until `unplug`."""

    say = Device.write

    def __init__(self, link: str) -> None:
        """`link`: the path that leads to the terminal."""
        super().__init__(Path(link))
        self.board = SimulatedBoard(time.monotonic_ns())
        self.received: list[bytes] = []
        """The program's lines."""
        self._ends = threading.Event()
        self._reads = threading.Event()
        self._reads.set()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def unplug(self) -> None:
        self._ends.set()
        self._thread.join()
        os.close(self._theirs)
        os.close(self.fd)

    def pause(self) -> None:
        """Read nothing any more."""
        self._reads.clear()

    def go_on(self) -> None:
        self._reads.set()

    def _serve(self) -> None:
        adapter = SimulatedAdapter()
        while not self._ends.is_set():
            self._reads.wait()
            select.select([self.fd], [], [], TICK_MS / 1000)
            data = self.read()
            self.received += data.split(b"\r")[:-1]
            frames, answers = adapter.take(data)
            self.write(answers)
            for frame in frames:
                self.write(b"".join(map(adapter.text, self.board.take(frame, time.monotonic_ns()))))
            self.write(b"".join(map(adapter.text, self.board.advance(time.monotonic_ns()))))
