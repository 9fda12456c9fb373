"""The terminal of `walk`: keys, the robot and drawing on a thread each, so that none waits for another."""

import math
import queue
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final

from rich.text import Text

from gateway.errors import GatewayError, LeaseError, ZenohError
from gateway.people.client.blocking import Client
from gateway.people.client.walk import Walk
from gateway.people.commands import driving, reach
from gateway.people.commands.reach import Connection
from gateway.people.commands.walk.keypad import Keypad
from gateway.people.commands.walk.script import went
from gateway.people.terminal import check_terminal
from gateway.people.terminal.screen import STYLES, Screen, fitted
from gateway.people.walking import GAITS, Velocity, ground_now
from gateway.text import visible
from schemas.telemetry import Mode

_TICK_S: Final = 0.02
KEYS_HOLD_S: Final = 0.25
"""If the drive thread freezes, the robot stands after this time. The thread commands 50 times a second."""
KEYS_REST_S: Final = 60.0
"""After so long without a key the robot sits down, and its servos are stopped."""
HEIGHT_STEP_M: Final = 0.01
_GAITS: Final = {str(number): name for number, name in enumerate(GAITS, 1)}
_KEYS: Final = f"""
  W S ↑ ↓   forward, backward          {" ".join(_GAITS)}   {", ".join(GAITS)}
  ← →       turn                       + -     faster, slower
  A D       step sideways              r f     higher, lower
  t         stand     c  sit down      q       sit down, stop and leave
                                       g       go on after a stop (a person's word)
"""
_UNCONFIRMED: Final = "Nobody has confirmed that the legs are stopped: if they hold, switch the servos' power off."


class WalkScreen(Screen):
    """Drives the robot from the keyboard until q."""

    def __init__(
        self, client: Client, holder: str, gait: str, geometry: Path | None, terrain: str, height_m: float | None
    ) -> None:
        """`holder`: our name as the lease has it."""
        super().__init__(client.estop)
        self._client = client
        self._holder = holder
        self._walk: Walk = client.walk(gait, geometry, terrain=terrain)
        self._height_m = height_m
        self._pad = Keypad()
        self._todo: queue.SimpleQueue[Callable[[], object]] = queue.SimpleQueue()
        self._driven = threading.Event()
        """Set at the end: keys move nothing any more."""
        self._message = "Nothing moves before you press a key."
        self._sits = False
        self._legs_stopped = True
        """Whether the Stops at the end are confirmed, or none was needed."""

    def run(self) -> int:
        """Until q (it sits down first), Ctrl-C or a signal (it is stopped at once). Returns the exit code."""
        self._walk.open()
        self._walk.hold_s, self._walk.rest_s = KEYS_HOLD_S, KEYS_REST_S
        with self.receives(self._client.session):
            return self.show()

    def begin(self) -> None:
        threading.Thread(target=self._drive, name="drive", daemon=True).start()

    def end(self) -> None:
        self._driven.set()
        try:
            self._walk.close(sits=self._sits)
        except ZenohError:
            self._legs_stopped = False
            raise

    def last_words(self) -> list[str]:
        return super().last_words() or ([] if self._legs_stopped else [_UNCONFIRMED])

    # ---- keys

    def press(self, key: str) -> bool:
        if key in ("q", "escape"):
            self._sits, self._message = True, "It sits down …"
            self._pad.release()
            return False
        if not self._pad.press(key, time.monotonic()):
            self._act(key.lower())
        return True

    def request_stop(self) -> None:
        super().request_stop()
        self._pad.release()
        self._message = ""

    def _act(self, key: str) -> None:
        walk = self._walk
        if key == "t":
            self._todo.put(lambda: walk.stand(self._height_m))
        elif key == "c":
            self._todo.put(walk.sit)
        elif key == "g":
            with self.changes():  # here, in the order of the keys: not a Stop that is pressed after it
                self.take_stop_back()
            self._todo.put(self._go_on)
        elif key in _GAITS:
            self._todo.put(lambda: walk.walk_as(_GAITS[key]))
        elif key in ("r", "f"):
            self._todo.put(lambda: self._rise(HEIGHT_STEP_M if key == "r" else -HEIGHT_STEP_M))

    def _rise(self, by_m: float) -> None:
        height_m = (self._height_m or self._walk.state.height_m) + by_m
        self._walk.stand(height_m)
        self._height_m = height_m

    def _go_on(self) -> None:
        if self._client.state().mode == Mode.ESTOPPED:
            self._client.reset()
        self._walk.start_again()
        self._message = "It goes on with the next key."

    # ---- the robot

    def _drive(self) -> None:
        if self._height_m is not None:
            height_m = self._height_m
            self._todo.put(lambda: self._walk.stand(height_m))
        while not self._driven.is_set():
            try:
                if not self._todo.empty():
                    self._message = ""
                    self._todo.get()()
                velocity = self._pad.velocity(time.monotonic())
                if velocity.moves:
                    self._walk.go(*velocity)
                else:
                    self._driven.wait(_TICK_S)
            except (GatewayError, RuntimeError) as error:
                self._message = str(error) if self._walk.error is None else f"{error}; g goes on"
                self._pad.release()

    # ---- drawing

    def picture(self, columns: int, rows: int) -> Text:
        title = f"walk · {visible(' '.join(self._client.robot[1:]))} · {visible(self._holder)} drives"
        stop = self.stop_remark()
        lines = [Text(title, "bold")]
        if stop is not None:
            lines.append(Text(stop.text, STYLES[stop.tone]))
        lines += self._lines()
        wrapped = [row for line in lines for row in line.wrap(self._console, max(1, columns))]
        return fitted(wrapped, Text(), columns, rows, stop)

    def _lines(self) -> list[Text]:
        try:
            state, now = self._walk.state, self._walk.now
        except RuntimeError:  # it is over
            return [Text("It is stopped.")]
        return [
            Text(visible(self._message), "bold red" if state.lost else ""),
            Text(),
            Text(f"  {visible(now)}"),
            Text(f"  {state.gait}, {100 * state.height_m:.0f} cm high, keys: {self._pad.speed_m_s:g} m/s"),
            Text(f"  commanded  {_shown(self._pad.velocity(time.monotonic()))}"),
            Text(f"  scaled to  {_shown(state.scaled)}  ").append(state.limit, "yellow"),
            Text(f"  went       {went(state)}"),
            *([Text(f"  ground     {ground}")] if (ground := ground_now(state)) else []),
            *map(Text, _KEYS.splitlines()),
        ]


def _shown(velocity: Velocity) -> str:
    forward, left, turn = velocity
    return f"{forward:+.2f} m/s ahead, {left:+.2f} m/s left, {math.degrees(turn):+.0f} °/s"


def drive(connect: Connection, gait: str, geometry: Path | None, terrain: str, height_m: float | None) -> int:
    """Drive until q. Returns the exit code. Raises WalkError, ConfigError, ZenohError."""
    without_one = "; without one: --forward 0.1 --seconds 5"
    check_terminal("walk from the keyboard", without_one, on_windows=", or give --seconds")
    with connect() as client:
        try:
            with client.lease(source=reach.me()) as lease:
                return WalkScreen(client, lease.holder, gait, geometry, terrain, height_m).run()
        except LeaseError as error:
            return driving.rejected(error)
