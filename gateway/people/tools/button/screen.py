"""The terminal of `button`: one thing, as large as the terminal is."""

import textwrap
import time
from typing import Final

from rich.text import Text

from gateway.people.client.blocking import Client
from gateway.people.client.button import Button
from gateway.people.client.stops import UntilConfirmed
from gateway.people.client.subscriptions import reports, subscribed
from gateway.people.terminal import check_terminal, screen
from gateway.people.tools.button.check_ins import CheckIns
from gateway.people.tools.reach import Connection
from gateway.text import visible
from schemas import keys as wire
from schemas.telemetry import Ack, GatewayState, Mode

SEEN_S: Final = 0.5
"""A picture that is older than this is not drawn any more: the terminal is stuck, and its button checks in no more."""
BELL_S: Final = 1.0
_STOPPED: Final = frozenset({Mode.ESTOPPED})


class ButtonScreen(screen.Screen):
    """Shown until Ctrl-C; each other key stops, whatever is shown: what is shown may be wrong."""

    def __init__(self, client: Client, button: Button) -> None:
        """`button` is registered."""
        super().__init__()
        self._client = client
        self._button = button
        self._stop = UntilConfirmed(button.press, self._answered)
        self._check_ins = CheckIns(button, self._is_drawn, lambda: client.state().uptime_s)
        self._drawn_s = float("-inf")
        self._state: GatewayState | None = None
        self._pressed = ""
        self._bell_s = 0.0

    def run(self) -> int:
        """Returns the exit code."""
        with subscribed(self._client.session, {wire.STATE: reports(GatewayState, self._take)}):
            return self.show()

    def begin(self) -> None:
        self._check_ins.start()

    def end(self) -> None:
        if self._check_ins.refused:
            self.failures.append(self._check_ins.refused)
        self._check_ins.end()

    def press(self, keys: list[str]) -> bool:
        if keys == ["ctrl-c"]:
            return False
        self._pressed = "STOPPING …"
        self._stop.press()
        return True

    def _answered(self, outcome: Ack | Exception) -> bool:
        if isinstance(outcome, Ack):
            self._pressed = f"STOPPED: {outcome.stop_frames} Stop frames written"
        else:
            self._pressed = "NOT STOPPED: no gateway answered; it is tried again"
        return True

    # ---- what is known

    def _take(self, state: GatewayState) -> None:
        self._state = state

    def _is_drawn(self) -> bool:
        return time.monotonic() - self._drawn_s < SEEN_S

    # ---- drawing

    def picture(self, columns: int, rows: int) -> Text:
        self._drawn_s = time.monotonic()
        found, style = self._lines()
        lines = [row for line in found for row in textwrap.wrap(line, max(1, columns)) or [""]]
        above = max(0, (rows - len(lines)) // 2)
        centred = [line.center(columns) for line in lines]
        filled = [" " * columns] * above + centred + [" " * columns] * max(0, rows - above - len(lines) - 1)
        return Text("\n".join(filled), style=style, no_wrap=True)

    def _lines(self) -> tuple[list[str], str]:
        check_ins, name = self._check_ins, visible(self._button.name)
        alive, required = check_ins.count
        counted = f"{name} · {alive} alive, {required} required"
        if check_ins.refused:
            why = visible(check_ins.refused)
            lines = ["ITS SILENCE STOPS NOTHING", "", why, "", self._pressed or "any key still stops the robot"]
            return [*lines, "Ctrl-C leaves"], "bold white on red"
        if not check_ins.heard:
            self._ring()
            silent = f"for {check_ins.silent_ms / 1000:.1f} s"
            why = visible(check_ins.trouble)
            lines = ["THE GATEWAY DOES NOT HEAR THIS BUTTON", silent, "", why, "", self._pressed or counted]
            return lines, "bold white on red"
        if self._state is not None and self._state.mode in _STOPPED:
            lines = ["STOPPED", "", self._pressed, "", counted, "Ctrl-C leaves · the driver resets"]
            return lines, "bold black on yellow"
        late_s = check_ins.late_s(check_ins.timeout_ms / 1000)
        late = "" if late_s is None else f"ITS ANSWERS COME LATE: after {late_s:.1f} s"
        lines = [
            "ANY KEY STOPS THE ROBOT",
            "",
            self._pressed,
            late or visible(check_ins.detail),
            counted,
            "Ctrl-C leaves",
        ]
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
