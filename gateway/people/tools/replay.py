"""`replay`: the frames of a recording as commands again, in their time; and whether the gateway writes the same."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

from gateway.errors import ConfigError, LeaseError
from gateway.people.recordings import Losses, read
from gateway.people.recordings.comparing import NS_PER_MS, Frames, compare
from gateway.people.recordings.replaying import Expected, Plan, Step, steps_of, survey
from gateway.people.recordings.user_angles import UserAngles, user_bytes
from gateway.people.terminal import Progress, agrees, hint, say
from gateway.people.tools.driving import drives, rejected
from gateway.people.tools.player import Player, without_pauses
from gateway.people.tools.reach import Connection, check_at_rest
from gateway.robot.core.calibration import Calibration, calibration_of
from schemas.keys import CALIBRATION, FRAME, STATE
from schemas.telemetry import GatewayState

SOURCE: Final = "hexapod-gateway replay"


def replay(connect: Connection, path: Path, *, speed: float, check: bool, agreed: bool, tolerance_ms: float) -> int:
    """Replay `path` and return the exit code. Raises ConfigError, RejectedError, StoppedError, ZenohError."""
    if check and speed != 1:
        raise ConfigError("--check compares times, so it goes with --speed 1")
    recording = _Recording(path, watchdog_too=speed != 1)
    recorded, angles, losses = recording.survey()
    _look_at(path, recorded, losses)
    with connect() as client:
        state = client.state()
        _fit(state, recorded, speed)
        target = calibration_of(client.calibration()) if state.calibration.revision else Calibration()
        _same_angles(path, angles, target)
        if check and not state.simulated:
            hint("This is a real controller; what it writes is compared all the same.")
        if losses and not state.simulated:
            raise ConfigError(f"{path}: {losses}. A real robot would leap over them, so nothing is sent")
        if not state.simulated:
            _ask(recorded, speed, agreed=agreed)
        expected = Expected() if check else None
        steps = recording.steps(expected)
        player = Player(client, recorded, steps, speed, expected=expected, on_time=check and state.simulated)
        try:
            with without_pauses(), drives(client, recorded.duration_ns / speed / 1e9 + 1, moves=True) as lease:
                player.run(lease)
        except LeaseError as error:
            return rejected(error)
    sent = f"{len(player.sent)} commands in {recorded.duration_ns / speed / 1e9:.1f} s"
    if expected is None:
        say(f"replayed: {sent}")
        return 0
    return _report(expected, player, target, sent, tolerance_ms)


class _Recording:
    """A recording's steps, read from the file each time: an hour of them as objects would take 600 MB."""

    def __init__(self, path: Path, *, watchdog_too: bool) -> None:
        self._path = path
        self._watchdog_too = watchdog_too

    def survey(self) -> tuple[Plan, UserAngles, Losses]:
        """What it comes to, which is known before anything moves."""
        angles, losses = UserAngles(), Losses()
        with Progress() as progress:
            plan = survey(
                self._frames(angles, losses),
                lambda plan: progress.show(f"reading {self._path}: {plan.duration_ns / 1e9:.0f} s of it"),
            )
        return plan, angles, losses

    def steps(self, expected: Expected | None) -> Iterator[Step]:
        """The steps to send; what the gateway then writes is added to `expected`."""
        frames = self._frames(UserAngles(), Losses())
        return steps_of(frames, watchdog_too=self._watchdog_too, expected=expected)

    def _frames(self, angles: UserAngles, losses: Losses) -> Iterator[Mapping[str, Any]]:
        return angles.frames(read(self._path, losses, (STATE, CALIBRATION, FRAME)))


def _same_angles(path: Path, angles: UserAngles, target: Calibration) -> None:
    """Raises ConfigError where what is sent could be other angles than those that were meant.

    A servo that is trimmed by 20 degrees would be sent 40 away from where it stood. Without any calibration here, what
    is sent is what is written, and each servo goes to where it went.
    """
    if angles.known or not (angles.translated or target.servos):
        return
    raise ConfigError(
        f"{path}: does not say by which calibration its frames were written, so their angles are not known here; "
        "nothing is sent"
    )


def _look_at(path: Path, recorded: Plan, losses: Losses) -> None:
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


def _report(expected: Expected, player: Player, target: Calibration, sent: str, tolerance_ms: float) -> int:
    written = _in_its_time(expected.frames, player, target)
    found = compare(expected.frames, expected.recorded_ns, player.sent, written, tolerance_ms)
    for difference in found.differences:
        say(difference)
    say(
        f"{'the same' if found.passes else 'NOT the same'}: {sent}; {found.frames} frames expected, "
        f"{len(written)} written, {found.same} of them the same, {found.swapped} overtaken by another leg's, "
        f"at most {found.worst_ms:.2f} ms from their time (p99 {found.p99_ms:.2f} ms)"
    )
    if found.beyond:
        say(f"{found.beyond} frames are more than {tolerance_ms:g} ms from it, the worst at {found.worst_at_s:.3f} s")
    late_ms = sorted(late_ns / NS_PER_MS for late_ns in player.late_ns)
    hint(
        f"Times are counted from when each command was sent: this machine was at most {late_ms[-1]:.2f} ms late "
        f"(p99 {late_ms[len(late_ms) * 99 // 100]:.2f} ms)."
    )
    return 0 if found.passes else 1


def _in_its_time(expected: Frames, player: Player, target: Calibration) -> Frames:
    """What was written, in users' angles, without the repeats of Stops that the recording ended before."""
    count = len(player.written)
    if count:
        begun_ns = player.written.at_ns[0] - expected.at_ns[0]
        end_ns = begun_ns + expected.at_ns[-1] + player.slipped_ns
        while count > len(expected) and player.written.at_ns[count - 1] > end_ns:
            count -= 1
    found = Frames()
    for place in range(count):
        frame = player.written.frame(place)
        found.append(frame._replace(data=user_bytes(target, frame.data)))
    return found
