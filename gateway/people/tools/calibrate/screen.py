"""The screen of `calibrate`. Neither its keys nor what it draws wait for the gateway."""

import os
from typing import Final

from rich.text import Text

from gateway.errors import LeaseError, LeaseLostError
from gateway.people.client.blocking import Client
from gateway.people.terminal import check_terminal, say, screen
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
from gateway.text import visible
from schemas.telemetry import GatewayState

STOP_S: Final = 2.5
"""How long the end waits for the Stop to be confirmed: longer than a client does, with its timeout of 2 s."""


class Screen(screen.Screen):
    """One walk through the guide; shown until somebody leaves."""

    def __init__(self, client: Client, calibration: Calibration, state: GatewayState) -> None:
        """`calibration` is in force, in a gateway that is in this state."""
        super().__init__()
        self._where = visible(" ".join(client.robot[1:]))
        self._began_from = calibration.revision
        self._unkept = once.unkept(state.calibration)
        self.held = HeldServo(client, state.watchdog.timeout_ms)
        self.robot = Robot(client, self._lost)
        guide = Guide(calibration, avoided_by(state.spi.framing))
        self.session = Session(guide, self.held, self.robot, self.changed.set)
        if landing_ms := state.watchdog.landing_ms:
            lands = f"A servo that falls silent goes to its landing angle, in {landing_ms:g} ms, and is stopped there. "
            self.session.message = lands
        self.session.message += self._unkept

    def begin(self) -> None:
        """Nothing: the robot is driven already."""

    def end(self) -> None:
        """The servo is stopped first."""
        if not self.held.close(STOP_S):
            self.failures.append("NOBODY HAS CONFIRMED THE STOP: if the servo holds, switch the servos' power off.")
        self.robot.release()

    def last_words(self) -> list[str]:
        """What is not written, or what is in force now."""
        guide = self.session.guide
        if guide.changed:
            rows = (f"  servo {servo_id}: {once.row(guide.draft[servo_id])}" for servo_id in guide.changed)
            return ["not written:", *rows]
        if guide.in_force.revision != self._began_from:
            return [f"revision {guide.in_force.revision} is in force. {self._unkept}".rstrip()]
        return []

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
        screen = Screen(client, calibration, state)
        try:
            screen.robot.drive()
        except LeaseError as error:
            return driving.not_acquired(client, error)
        code = screen.show()
        # Not by the interpreter's own end: it aborts while a thread is inside Zenoh, and one may be for ten seconds (a
        # frozen gateway), or for ever in a stuck terminal. The servo is stopped, and the lease released.
        os._exit(code)
