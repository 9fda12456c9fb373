"""The screen of `calibrate`. Neither its keys nor what it draws wait for the gateway."""

import os
from contextlib import suppress
from typing import Final

from rich.text import Text

from gateway.errors import LeaseError, LeaseLostError
from gateway.people.client.blocking import Client
from gateway.people.terminal import check_terminal, hint, say, screen, visible
from gateway.people.tools import driving
from gateway.people.tools.calibrate import once
from gateway.people.tools.calibrate.guide import Guide
from gateway.people.tools.calibrate.held_servo import HeldServo
from gateway.people.tools.calibrate.robot import Robot
from gateway.people.tools.calibrate.session import Session
from gateway.people.tools.calibrate.view import picture
from gateway.people.tools.reach import Connection, why_not_at_rest
from gateway.robot.core.calibration import Calibration, calibration_of
from gateway.robot.protocol.framing import avoided_by
from schemas.telemetry import GatewayState

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
        """Nothing: the robot is driven already."""

    def end(self) -> None:
        """The servo is stopped first."""
        self.stopped = self.held.close(STOP_S)
        self.robot.release()

    def _lost(self, error: LeaseLostError) -> None:
        self.session.lost(error)

    def press(self, keys: list[str]) -> bool:
        """A Stop among them is all that counts."""
        for stop in (" ", "ctrl-c"):
            if stop in keys:
                return self.session.press(stop)
        return all(self.session.press(key, alone=len(keys) == 1) for key in keys)

    def picture(self, columns: int, rows: int) -> Text:
        with self.session.lock:
            self.session.turn()
            return picture(self.session, self._where, rows, columns)


_OTHERWISE: Final = (
    ", and somebody beside the robot; --show prints the calibration, and a program uses Client.calibrate"
)


def run(connect: Connection) -> int:
    """Guide. Raises ZenohError where no gateway answers."""
    check_terminal("calibrate", _OTHERWISE)
    with connect() as client:
        state = client.state()
        fault = state.calibration.fault
        trouble = why_not_at_rest(state) if fault is None else once.untrusted(fault)
        if trouble is not None:
            say(trouble)
            return 1
        try:
            calibration = calibration_of(client.calibration())
        except ValueError as error:
            say(f"what the gateway says is no calibration: {error}")
            return 1
        where = visible(" ".join(client.robot[1:]))
        screen = Screen(client, calibration, state.watchdog.timeout_ms, where, avoided_by(state.spi.framing))
        try:
            screen.robot.drive()
        except LeaseError as error:
            return driving.not_acquired(client, error)
        screen.session.message = _remarks(state)
        if screen.show():
            with suppress(OSError):  # the terminal is gone
                if not screen.stopped:
                    hint("NOBODY HAS CONFIRMED THE STOP: if the servo holds, switch the servos' power off.")
                screen.hint_at_fault()
                _last_words(screen.session.guide, calibration.revision, once.unkept(state.calibration))
        # Not by the interpreter's own end: it aborts while a thread is inside Zenoh, and one may be for ten seconds (a
        # frozen gateway), or for ever in a stuck terminal. The servo is stopped, and the lease released.
        os._exit(0 if screen.stopped and screen.fault is None else 1)


def _remarks(state: GatewayState) -> str:
    """What a person wants to know before anything moves."""
    landing_ms = state.watchdog.landing_ms
    lands = f"A servo that falls silent goes to its landing angle, in {landing_ms:g} ms, and is stopped there. "
    return lands * bool(landing_ms) + once.unkept(state.calibration)


def _last_words(guide: Guide, began_from: int, unkept: str) -> None:
    if guide.changed:
        say("not written:")
        for servo_id in guide.changed:
            servo = guide.draft[servo_id]
            say(f"  servo {servo_id}: {once.row(servo)}")
    elif guide.in_force.revision != began_from:
        say(f"revision {guide.in_force.revision} is in force. {unkept}".rstrip())
