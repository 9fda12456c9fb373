"""The screen of `calibrate`. Neither its keys nor what it draws wait for the gateway."""

from typing import Final

from rich.text import Text

from gateway.errors import LeaseLostError
from gateway.people.client.blocking import Client
from gateway.people.terminal import screen
from gateway.people.tools.calibrate.guide import Guide
from gateway.people.tools.calibrate.held_servo import HeldServo
from gateway.people.tools.calibrate.robot import Robot
from gateway.people.tools.calibrate.session import Session
from gateway.people.tools.calibrate.view import picture
from gateway.robot.core.calibration import Calibration

STOP_S: Final = 2.5
"""How long the end waits for the Stop to be confirmed: longer than a client does, with its timeout of 2 s."""


class Screen(screen.Screen):
    """One walk through the guide; shown until somebody leaves."""

    def __init__(
        self,
        client: Client,
        calibration: Calibration,
        timeout_ms: float,
        where: str,
        avoid_cdeg: tuple[int, int] | None = None,
    ) -> None:
        """`timeout_ms` is the gateway's `watchdog.timeout_ms`; `where` is what the title names of the robot.

        `avoid_cdeg`: angles that the gateway never sends; keys move over them.
        """
        super().__init__()
        self._where = where
        self.held = HeldServo(client, timeout_ms)
        self.robot = Robot(client, self._lost)
        self.session = Session(Guide(calibration, avoid_cdeg), self.held, self.robot, self.changed.set)
        self.stopped = True
        """Whether the Stop at the end was confirmed, if one was needed."""

    def begin(self) -> None:
        """See `screen.Screen`."""

    def end(self) -> None:
        """See `screen.Screen`. The servo is stopped first."""
        self.stopped = self.held.close(STOP_S)
        self.robot.release()

    def _lost(self, error: LeaseLostError) -> None:
        self.session.lost(error)

    def press(self, keys: list[str]) -> bool:
        """See `screen.Screen`. A Stop among them is all that counts."""
        for stop in (" ", "ctrl-c"):
            if stop in keys:
                return self.session.press(stop)
        return all(self.session.press(key, alone=len(keys) == 1) for key in keys)

    def picture(self, columns: int, rows: int) -> Text:
        """See `screen.Screen`."""
        with self.session.lock:
            self.session.turn()
            return picture(self.session, self._where, rows, columns)
