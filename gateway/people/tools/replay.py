"""`replay`: the frames of a recording as commands again, in their time."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

from gateway.allowance import NS_PER_MS
from gateway.errors import ConfigError, LeaseError
from gateway.model.calibration import RobotCalibration, calibration_of
from gateway.people.recordings import ReadLosses, read
from gateway.people.recordings.replaying import Plan, ReplayStep, steps_of, survey
from gateway.people.recordings.user_angles import UserAngles
from gateway.people.terminal import Progress, agrees, hint, say
from gateway.people.tools.driving import drives, rejected
from gateway.people.tools.player import Player, without_pauses
from gateway.people.tools.reach import Connection, check_at_rest
from schemas.keys import CALIBRATION, FRAME, STATE
from schemas.telemetry import GatewayState

REPLAY_SOURCE: Final = "hexapod-gateway replay"


def replay(connect: Connection, path: Path, *, speed: float, agreed: bool) -> int:
    """Replay `path` and return the exit code. Raises ConfigError, RejectedError, StoppedError, ZenohError."""
    recording = _Recording(path, watchdog_too=speed != 1)
    recorded, angles, losses = recording.survey()
    _look_at(path, recorded, losses)
    with connect() as client:
        state = client.state()
        _fit(state, recorded, speed)
        target = calibration_of(client.calibration()) if state.calibration.revision else RobotCalibration()
        _same_angles(path, angles, target)
        if losses and not state.simulated:
            raise ConfigError(f"{path}: {losses}. A real robot would leap over them, so nothing is sent")
        if not state.simulated:
            _ask(recorded, speed, agreed=agreed)
        player = Player(client, recorded, recording.steps(), speed)
        try:
            with without_pauses(), drives(client, recorded.duration_ns / speed / 1e9 + 1, moves=True):
                player.run()
        except LeaseError as error:
            return rejected(error)
    say(f"replayed: {player.sent} commands in {recorded.duration_ns / speed / 1e9:.1f} s")
    return 0


class _Recording:
    """A recording's steps, read from the file each time: an hour of them as objects would take 600 MB."""

    def __init__(self, path: Path, *, watchdog_too: bool) -> None:
        self._path = path
        self._watchdog_too = watchdog_too

    def survey(self) -> tuple[Plan, UserAngles, ReadLosses]:
        """What it comes to, which is known before anything moves."""
        angles, losses = UserAngles(), ReadLosses()
        with Progress() as progress:
            plan = survey(
                self._frames(angles, losses),
                lambda plan: progress.show(f"reading {self._path}: {plan.duration_ns / 1e9:.0f} s of it"),
            )
        return plan, angles, losses

    def steps(self) -> Iterator[ReplayStep]:
        return steps_of(self._frames(UserAngles(), ReadLosses()), watchdog_too=self._watchdog_too)

    def _frames(self, angles: UserAngles, losses: ReadLosses) -> Iterator[Mapping[str, Any]]:
        return angles.frames(read(self._path, losses, (STATE, CALIBRATION, FRAME)))


def _same_angles(path: Path, angles: UserAngles, target: RobotCalibration) -> None:
    """Raises ConfigError where the angles sent could differ from those recorded.

    A servo that is trimmed by 20 degrees would be sent 40 away from where it stood. Without any calibration here, what
    is sent is what is written, and each servo goes to where it went.
    """
    if angles.known or not (angles.translated or target.servos):
        return
    raise ConfigError(
        f"{path}: does not contain the calibration of its frames, so their angles are not known here; nothing is sent"
    )


def _look_at(path: Path, recorded: Plan, losses: ReadLosses) -> None:
    if losses:
        hint(f"{path}: {losses}; the replay leaves them out, too.")
    if losses.cut_off:
        hint(f"{path}: was cut off; what had been written by then is replayed.")
    if not recorded.legs:
        raise ConfigError(
            f"{path}: has no frames that commands caused; record with telemetry.frames = true at the gateway"
        )
    if recorded.begun_running:
        hint(f"The recording begins while servos run: {recorded.begun_running} first Sets are sent as Starts.")
    if recorded.left_out:
        hint(
            f"{recorded.left_out} frames are left out: incomplete, of no protocol, or after a new start of the "
            "gateway's machine."
        )


def _fit(state: GatewayState, recorded: Plan, speed: float) -> None:
    """Raises ConfigError where this gateway cannot follow."""
    check_at_rest(state)
    gap_ms = recorded.longest_gap_ns / NS_PER_MS / speed
    if speed == 1 and gap_ms > state.watchdog.timeout_ms:
        hint(
            f"Once there are {gap_ms:.0f} ms between two setpoints of a leg: the recorded gateway stood still, or has "
            f"a longer watchdog. This one stops it after {state.watchdog.timeout_ms:g} ms, and the replay ends there."
        )
    elif gap_ms > state.watchdog.timeout_ms:
        raise ConfigError(
            f"at --speed {speed:g} there are {gap_ms:.0f} ms between two setpoints of a leg, and the watchdog stops it "
            f"after {state.watchdog.timeout_ms:g} ms; a faster replay goes"
        )


def _ask(recorded: Plan, speed: float, *, agreed: bool) -> None:
    """A real robot moves only with consent."""
    legs = sorted(recorded.legs)
    what = (
        f"This is a real robot. Its legs {', '.join(map(str, legs))} will go to where the recording begins at once, as "
        f"fast as they can, and then move for {recorded.duration_ns / speed / 1e9:.0f} s. Ctrl-C stops them."
    )
    hint(what)
    if not agreed and not agrees("Is it free to move, with somebody at the switch of its supply?"):
        raise ConfigError("nothing was sent")
