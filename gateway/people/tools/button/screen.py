"""The terminal of `button`: the whole of it shows whether it works."""

import textwrap
import time
from typing import Final

from rich.text import Text

from gateway.people.client.blocking import Client
from gateway.people.client.button import Button
from gateway.people.terminal import check_terminal
from gateway.people.terminal.screen import ALARM, Screen
from gateway.people.terminal.stop_status import Tone
from gateway.people.tools.button.check_ins import CheckIns
from gateway.people.tools.reach import Connection
from gateway.text import visible
from schemas.telemetry import GatewayState, Mode

SEEN_S: Final = 0.5
"""If the last picture is older, the terminal is stuck, and its button no longer checks in."""
BELL_S: Final = 1.0


class ButtonScreen(Screen):
    """Shown until Ctrl-C; each other key stops the robot, whatever is shown, since that may be wrong."""

    def __init__(self, client: Client, button: Button) -> None:
        """`button`: already registered."""
        super().__init__(button.press)
        self._client = client
        self._button = button
        self._check_ins = CheckIns(button, self._is_drawn, lambda: client.state().uptime_s)
        self._state: GatewayState | None = None
        self._bell_s = 0.0

    def run(self) -> int:
        """Show it until Ctrl-C. Returns the exit code."""
        with self.receives(self._client.session):
            return self.show()

    def begin(self) -> None:
        self._check_ins.start()

    def end(self) -> None:
        if self._check_ins.refused:
            self.failures.append(self._check_ins.refused)
        self._check_ins.end()

    def stops(self, keys: list[str]) -> bool:
        """Each key, also one that has no name here; Ctrl-C alone leaves."""
        return keys != ["ctrl-c"]

    # ---- received

    def take_state(self, state: GatewayState) -> None:
        super().take_state(state)
        with self.changes():
            self._state = state
            self.stop.receive_state(state.estop, estopped=state.mode == Mode.ESTOPPED)

    def _is_drawn(self) -> bool:
        return time.monotonic() - self.drawn_s < SEEN_S

    # ---- drawing

    def picture(self, columns: int, rows: int) -> Text:
        found, style = self._lines()
        lines = [row for line in found for row in textwrap.wrap(line, max(1, columns)) or [""]]
        above = max(0, (rows - len(lines)) // 2)
        centred = [line.center(columns) for line in lines]
        filled = [" " * columns] * above + centred + [" " * columns] * max(0, rows - above - len(lines) - 1)
        return Text("\n".join(filled[:rows]), style=style, no_wrap=True)

    def _lines(self) -> tuple[list[str], str]:
        """The most important line first, and their style."""
        check_ins, name = self._check_ins, visible(self._button.name)
        alive, required = check_ins.count
        counted = f"{name} · {alive} alive, {required} required"
        stop = self.stop_remark()
        pressed = "" if stop is None else stop.text
        if check_ins.refused:
            why = visible(check_ins.refused)
            lines = ["ITS SILENCE STOPS NOTHING", "", why, "", pressed or "any key still stops the robot"]
            return [*lines, "Ctrl-C leaves"], ALARM
        if not check_ins.is_counted:
            self._ring()
            silent = f"for {check_ins.silent_ms / 1000:.1f} s"
            why = visible(check_ins.trouble)
            lines = ["THE GATEWAY DOES NOT RECEIVE THIS BUTTON", silent, "", why, "", pressed or counted]
            return lines, ALARM
        if stop is not None and stop.tone is Tone.BAD:
            return [pressed, "", counted, "Ctrl-C leaves"], ALARM
        if self._state is not None and self._state.mode == Mode.ESTOPPED:
            return ["STOPPED", "", pressed, "", counted, "Ctrl-C leaves · the driver resets"], "bold black on yellow"
        late_s = check_ins.late_s(check_ins.timeout_ms / 1000)
        late = "" if late_s is None else f"ITS ANSWERS COME LATE: after {late_s:.1f} s"
        status = late or visible(check_ins.detail)
        lines = ["ANY KEY STOPS THE ROBOT", "", pressed, status, counted, "Ctrl-C leaves"]
        return lines, "bold white on dark_green"

    def _ring(self) -> None:
        """The terminal's bell, once a second."""
        now_s = time.monotonic()
        if now_s - self._bell_s >= BELL_S:
            self._bell_s = now_s
            self._console.bell()


def hold(connect: Connection, name: str) -> int:
    """Be a button until Ctrl-C, by this name where no certificate has one. Returns the exit code.

    Raises ConfigError, RejectedError, ZenohError.
    """
    check_terminal("button", "", on_windows=", or open the console's /button")
    with connect() as client:
        button = client.button(name)
        button.register()
        return ButtonScreen(client, button).run()
