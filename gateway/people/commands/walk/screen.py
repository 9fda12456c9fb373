"""The terminal of `walk`: keys, Stops, the robot and drawing on a thread each, so that none waits for another.

The Stop key works while the terminal takes no more output, and while the gateway is frozen.
"""

import importlib.util
import math
import os
import queue
import select
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Final

from rich.console import Console
from rich.live import Live
from rich.text import Text

from gateway.errors import GatewayError, LeaseError, ZenohError
from gateway.people.client.blocking import Client
from gateway.people.client.lease import Lease
from gateway.people.client.walk import Walk
from gateway.people.commands import reach
from gateway.people.commands.reach import Connection
from gateway.people.commands.walk.script import went
from gateway.people.terminal import REST_S, Keyboard, hint, keys_at_once, wake_on_signals
from gateway.people.walking.gaits import GAITS
from gateway.people.walking.motion import STILL, Velocity
from gateway.people.walking.words import ground_now
from gateway.people.watching.confirmed_stop import UntilConfirmed
from gateway.people.watching.dangers import ALARM, Remark
from gateway.words.text import visible
from schemas.event import Event
from schemas.gateway_state import GatewayState
from schemas.words import Mode

FRAME_S: Final = 0.1
"""Ages count up, so it draws ten times a second."""
LEAST_FRAME_S: Final = 0.03
"""Shortest time between two pictures, however much happens: drawing must not load the robot's computer."""
DRAWER_END_S: Final = 0.5
SMALL_ROWS: Final = 4
"""With fewer rows than this, a Stop that is not confirmed replaces everything else."""
STOP_KEYS: Final = frozenset({" ", "escape"})
"""The same as on the console's page."""
_READ: Final = 4096
"""The size of a terminal's buffer: keys pressed while this program could not run are one reading."""
PRESSED_S: Final = 0.7
"""How long a key counts when it is pressed: until the terminal repeats it, which takes up to 0.66 s (X11's default)."""
REPEATED_S: Final = 0.2
"""How long it counts after a repetition; these come every 30 to 90 ms."""
SPEEDS: Final = (0.02, 0.04, 0.06, 0.08, 0.1, 0.12)
"""m/s; the turning goes with it."""
_TURN: Final = 4.0
"""rad/s for each m/s."""
_DIRECTIONS: Final = {
    "w": Velocity(1, 0, 0),
    "up": Velocity(1, 0, 0),
    "s": Velocity(-1, 0, 0),
    "down": Velocity(-1, 0, 0),
    "a": Velocity(0, 1, 0),
    "d": Velocity(0, -1, 0),
    "left": Velocity(0, 0, _TURN),
    "right": Velocity(0, 0, -_TURN),
}

_TICK_S: Final = 0.02
KEYS_HOLD_S: Final = 0.25
"""If the drive thread freezes, the robot stands after this time. The thread commands 50 times a second."""
KEYS_REST_S: Final = 60.0
"""After this long without a key the robot sits down, and its servos are stopped."""
HEIGHT_STEP_M: Final = 0.01
_GAITS: Final = {str(number): name for number, name in enumerate(GAITS, 1)}
_KEYS: Final = f"""
  W S ↑ ↓   forward, backward          {" ".join(_GAITS)}   {", ".join(GAITS)}
  ← →       turn                       + -     faster, slower
  A D       step sideways              r f     higher, lower
  t         stand     c  sit down      q       sit down, stop and leave
                                       g       continue after a Stop, when safe
"""
NOT_STOPPED: Final = "The emergency stop was NOT confirmed: switch the servos' power off."
_UNCONFIRMED: Final = "Nobody has confirmed that the legs are stopped: if they hold, switch the servos' power off."


class Keypad:
    """The velocity of the key that was pressed last, for as long as it counts. Pure.

    A terminal reports presses and repetitions of a key, never its release.
    """

    def __init__(self) -> None:
        self._key = ""
        self._until_s = 0.0
        self._speed = SPEEDS.index(0.06)

    @property
    def speed_m_s(self) -> float:
        """The speed that a held key commands."""
        return SPEEDS[self._speed]

    def press(self, key: str, now_s: float) -> bool:
        """Take a key. Returns whether it belongs to the pad; any other key releases the held one."""
        key = key.lower()
        if key in ("+", "=", "-"):
            self._speed = max(0, min(len(SPEEDS) - 1, self._speed + (-1 if key == "-" else 1)))
            return True
        if key not in _DIRECTIONS:
            self.release()
            return False
        repeated = key == self._key and now_s < self._until_s
        self._key = key
        self._until_s = now_s + (REPEATED_S if repeated else PRESSED_S)
        return True

    def release(self) -> None:
        """Record that no key is held from now on."""
        self._key = ""

    def velocity(self, now_s: float) -> Velocity:
        if not self._key or now_s >= self._until_s:
            return STILL
        return _DIRECTIONS[self._key].times(self.speed_m_s)


class WalkScreen:
    """Drives the robot from the keyboard until q, a signal or a fault.

    Where drawing fails it ends: an old picture must not pass for the present state.
    """

    def __init__(
        self, client: Client, holder: str, gait: str, geometry: Path | None, terrain: str, height_m: float | None
    ) -> None:
        """`holder`: our name as the lease has it."""
        self._client = client
        self._holder = holder
        self._lease: Lease | None = None  # of its own, after `holder`'s was lost
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
        self._failures: list[str] = []
        self._changed = threading.Event()
        """Set to draw soon."""
        self._stop = UntilConfirmed(client.estop, self._changed.set)
        self._ended = threading.Event()
        self._wake = -1
        # The terminal's own size: exported COLUMNS and LINES do not follow a change of the window.
        environ = {name: value for name, value in os.environ.items() if name not in ("COLUMNS", "LINES")}
        self._console = Console(_environ=environ)
        self._live = Live(console=self._console, screen=True, auto_refresh=False, redirect_stderr=False)

    def run(self) -> int:
        """Drive until q (the robot sits down first), Ctrl-C or a signal (it stops at once). Return the exit code."""
        self._walk.open()
        self._walk.hold_s, self._walk.rest_s = KEYS_HOLD_S, KEYS_REST_S
        self._client.on_state(self._take_state)
        self._client.on_event(self._take_event)
        terminal, drawer = sys.stdin.fileno(), threading.Thread(target=self._draw, name="draw", daemon=True)
        with keys_at_once(terminal), wake_on_signals() as (woken, self._wake):
            threading.Thread(target=self._drive, name="drive", daemon=True).start()
            drawer.start()
            try:
                self._read_keys(terminal, woken)
            finally:
                self._driven.set()
                try:
                    self._walk.close(sits=self._sits)
                except GatewayError as error:
                    self._legs_stopped = not isinstance(error, ZenohError)
                    self._failures.append(str(error))
                finally:
                    self._ended.set()
                    self._changed.set()
                    drawer.join(DRAWER_END_S)
        return 1 if self._failures else 0

    # ---- received, on threads of Zenoh's

    def _take_state(self, state: GatewayState) -> None:
        with self._stop.changes() as status:
            status.power.received_state(state, time.monotonic_ns())

    def _take_event(self, event: Event) -> None:
        with self._stop.changes() as status:
            status.power.received_event(event.kind)

    # ---- keys

    def _read_keys(self, terminal: int, woken: int) -> None:
        keyboard = Keyboard()
        while True:
            ready, _, _ = select.select([terminal, woken], [], [], REST_S if keyboard.waits else None)
            if woken in ready:
                return
            try:
                data = os.read(terminal, _READ) if ready else b""
            except OSError:  # the terminal is gone
                return
            if (ready and not data) or not self._act_on(keyboard.keys(data)):
                return
            self._changed.set()

    def _act_on(self, keys: list[str]) -> bool:
        """Act on one reading. Return whether to go on. If a key requests the emergency stop, the others do nothing."""
        if STOP_KEYS.isdisjoint(keys):
            return all(map(self._press, keys))
        self._stop.press()
        self._pad.release()
        self._message = ""
        return True

    def _press(self, key: str) -> bool:
        if key == "ctrl-c":
            return False
        if key == "q":
            self._sits, self._message = True, "It sits down …"
            self._pad.release()
            return False
        if not self._pad.press(key, time.monotonic()):
            self._act(key.lower())
        return True

    def _act(self, key: str) -> None:
        walk = self._walk
        if key == "t":
            self._todo.put(lambda: walk.stand(self._height_m))
        elif key == "c":
            self._todo.put(walk.sit)
        elif key == "g":
            self._stop.take_back()  # here, in the order of the keys: must not take back a later Stop
            self._todo.put(self._go_on)
        elif key in _GAITS:
            self._todo.put(lambda: walk.walk_as(_GAITS[key]))
        elif key in ("r", "f"):
            self._todo.put(lambda: self._rise(HEIGHT_STEP_M if key == "r" else -HEIGHT_STEP_M))
        else:
            self._message = f"The key {key} does nothing."

    def _rise(self, by_m: float) -> None:
        height_m = (self._height_m or self._walk.state.height_m) + by_m
        self._walk.stand(height_m)
        self._height_m = height_m

    @property
    def _drives(self) -> bool:
        lease = self._client.carried_lease
        return lease is not None and lease.held

    def _go_on(self) -> None:
        if not self._drives:
            self._lease = self._client.lease(source=reach.me()).acquire()  # the end of the client releases it
        if self._client.state().mode == Mode.ESTOPPED:
            self._client.reset()
        self._walk.start_again()
        self._message = "It goes on with the next key."

    # ---- the robot

    def _drive(self) -> None:
        if self._height_m is not None:
            self._todo.put(lambda: self._walk.stand(self._height_m))
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
                said = error.lasting if isinstance(error, GatewayError) else str(error)
                self._message = said if self._walk.error is None else f"{said}; g goes on"
                self._pad.release()

    # ---- drawing

    def _draw(self) -> None:
        try:
            with self._live:
                while not self._ended.is_set():
                    self._changed.clear()
                    # Shown without any lock: this waits for the terminal.
                    self._live.update(self._picture(*self._console.size), refresh=True)
                    self._ended.wait(LEAST_FRAME_S)
                    self._changed.wait(FRAME_S - LEAST_FRAME_S)
        except Exception as error:
            why = f"cannot draw on this terminal ({error}); it needs UTF-8, such as LC_ALL=C.UTF-8"
            self._failures.append(why)
            os.write(self._wake, b".")
            self._ended.wait()
        status = self._stop.status
        last = NOT_STOPPED if status.wanted_ns is not None else status.power.sentence
        last = last or ("" if self._legs_stopped else _UNCONFIRMED)
        with suppress(OSError):  # the terminal is gone; in one that is stuck this waits, as drawing does
            for line in (*(f"hexapod-gateway: {failure}" for failure in self._failures), *([last] if last else [])):
                hint(line)

    def _picture(self, columns: int, rows: int) -> Text:
        drives = "drives" if self._drives else "does not drive"
        title = f"walk · {visible(' '.join(self._client.robot[1:]))} · {visible(self._holder)} {drives}"
        stop = self._stop.remark(time.monotonic_ns())
        lines = [Text(title, "bold"), *([] if stop is None else [Text(stop.text, stop.style)]), *self._lines()]
        wrapped = [row for line in lines for row in line.wrap(self._console, max(1, columns))]
        return fitted(wrapped, columns, rows, stop)

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


def fitted(lines: list[Text], columns: int, rows: int, stop: Remark | None = None) -> Text:
    """Return a picture of `rows` rows of at most `columns`: the first lines that fit, and the Stop key in the last row.

    In fewer than SMALL_ROWS rows a Stop that is not confirmed replaces the lines, and in a single row that key, too.
    """
    last = Text(" SPACE or ESC: EMERGENCY STOP ", ALARM)
    if stop is not None and stop.is_bad and rows < SMALL_ROWS:
        lines = [Text(f" {stop.text} ", ALARM)]
        last = lines[0] if rows == 1 else last
    shown = lines[: rows - 1]
    shown += [Text()] * (rows - 1 - len(shown))
    shown.append(last)
    for line in shown:
        line.truncate(columns)
    return Text("\n", no_wrap=True, overflow="crop", end="").join(shown)


def _shown(velocity: Velocity) -> str:
    forward, left, turn = velocity
    return f"{forward:+.2f} m/s ahead, {left:+.2f} m/s left, {math.degrees(turn):+.0f} °/s"


def drive(connect: Connection, gait: str, geometry: Path | None, terrain: str, height_m: float | None) -> int:
    """Drive until q. Returns the exit code. Raises GatewayError."""
    if importlib.util.find_spec("termios") is None:
        raise GatewayError("walk from the keyboard needs a Unix terminal; on Windows, run it in WSL, or use --seconds")
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        raise GatewayError("walk from the keyboard needs a terminal; without one: --forward 0.1 --seconds 5")
    with connect() as client:
        try:
            with client.lease(source=reach.me()) as lease:
                return WalkScreen(client, lease.holder, gait, geometry, terrain, height_m).run()
        except LeaseError as error:
            return reach.rejected(error)
