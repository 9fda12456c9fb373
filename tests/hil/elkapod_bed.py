"""The emulated device and a UART with a simulated controller of elkapod-2025 behind both, played by the test's process.

What is sent during a transfer was made ready before it, as on the robot: each transfer is given to the controller as it
is recorded, and what it then wants to say is what the next one reads. So no transfer waits for the test.
"""

import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from gateway.model.elkapod import SHUTDOWN, START
from tests.hil.bed import Message, Setting, SpiTestbed, Transfer
from tests.support.controllers import Elkapod

BEAT_S = 0.01
"""How often the controller is asked for what it wants to say over the UART."""
WORDS = {START: "start", SHUTDOWN: "shutdown"}


class ElkapodBed(SpiTestbed):
    """A robot of elkapod-2025 for unmodified programs: `/dev/spidev0.0`, and a UART at `uart`.

    `controller` has what its servos do, and switches for faults; those of transfers are the device's.
    """

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self.uart = folder / "ttyAMA1"
        self.controller = Elkapod()
        self.attach_uart(self.uart)
        self._player = threading.Thread(target=self._play, daemon=True)
        self._player.start()

    def close(self) -> str:
        ended = super().close()
        self._player.join()
        return ended

    def said_since(self, since: int = 0) -> list[str]:
        """From event `since` on: "frame", and "start" or "shutdown" on the UART. Raises KeyError for other bytes."""
        said = [event for event in self.events[since:] if not isinstance(event, Setting)]
        return [WORDS[event.data] if isinstance(event, Message) else "frame" for event in said]

    def settings_with(self, **sections: dict[str, Any]) -> dict[str, dict[str, Any]]:
        """For a gateway on this robot. Nothing counts as silent that only the machine's load makes wait."""
        return {
            **sections,
            "wire": {"name": "elkapod-2025"},
            "controller": {"uart": str(self.uart), "silent_ms": 2000, **sections.get("controller", {})},
        }

    def wait_until(self, holds: Callable[[], bool], timeout_s: float) -> None:
        """Until something holds that a frame can change: it is looked at behind each."""
        deadline_s = time.monotonic() + timeout_s
        while not holds():
            if time.monotonic() > deadline_s:
                raise TimeoutError(f"waited {timeout_s} s")
            self.follow(len(self.events), 0.1)

    def _play(self) -> None:
        seen = 0
        while (events := self.follow(seen, BEAT_S)) is not None:
            seen += len(events)
            try:
                for event in events:
                    if isinstance(event, Message):
                        self.controller.write(event.data)
                    elif isinstance(event, Transfer) and event.delivered:
                        self.tell("answer", self.controller.exchange(event.data))
                if beats := self.controller.read():
                    self.tell("send_uart", beats)
            except OSError:  # the emulation has ended
                return
