"""The commands of `calibrate` for scripts: export and import the calibration, and record the landing pose."""

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from pydantic import ValidationError

from gateway.errors import ConfigError, GatewayError, RejectedError, UnansweredError
from gateway.files import durable
from gateway.model.calibration import AS_DRAWN, ServoMapping, calibration_of, changed_servos
from gateway.model.frames import centidegrees
from gateway.people.client.blocking import Client
from gateway.people.client.payloads import calibration_payload
from gateway.people.commands import reach
from gateway.people.commands.reach import Connection
from gateway.people.terminal import NOBODY, ask, hint, say
from gateway.words.own_command import command
from schemas import calibration as wire
from schemas import keys
from schemas.ack import Ack
from schemas.gateway_state import GatewayState
from schemas.words import Reason

WAIT_S: Final = 60.0
"""How long to wait for the driver to hand over, or to end."""
_MOST_BYTES: Final = 64 * 1024
"""Limit of an imported file; a whole calibration takes 2 kB."""


def export(connect: Connection) -> int:
    """Print the whole calibration as JSON. Returns the exit code."""
    with connect() as client:
        sys.stdout.write(f"{client.calibration().model_dump_json(indent=2)}\n")
    return 0


def import_file(connect: Connection, file: Path, *, agreed: bool) -> int:
    """Send a file's whole calibration; ask first unless `agreed`. Returns the exit code. Raises ConfigError."""
    try:
        wanted = calibration_of(wire.Calibration.model_validate_json(_read(file)))
    except ValueError as error:  # pydantic's, and CalibrationError
        why = _faults(error) if isinstance(error, ValidationError) else error
        raise ConfigError(f"{file} is not a calibration as `calibrate export` prints it: {why}") from error
    with connect() as client:
        state, now = client.state(), calibration_of(client.calibration())
        changed, fault = changed_servos(now, wanted), state.calibration.fault
        if fault is None and not changed and now.landing_cdeg == wanted.landing_cdeg:
            kept = "kept on the robot" if state.calibration.kept else "until the next boot only"
            say(f"there is nothing to change: revision {now.revision}, {kept}")
            return 0
        if fault is not None:
            say(f"{fault}; the file is replaced")
        for servo_id in changed:
            say(f"{servo_id:5}  {_row(now.of(servo_id))}  becomes  {_row(wanted.of(servo_id))}".rstrip())
        if not agreed and not _agree("Is this the calibration of this robot?"):
            return 1
        servos = {name: change_of(wanted.of(name)) for name in changed}
        lands = {name: wanted.landing_cdeg.get(name) for name in now.landing_cdeg.keys() | wanted.landing_cdeg.keys()}
        landing_deg = {name: None if cdeg is None else cdeg / 100 for name, cdeg in lands.items()}
        payload = calibration_payload(servos, landing_deg, revision=now.revision, accept_default=fault is not None)
        return _change(client, f"the calibration is that of {file}", state, payload)


def _read(file: Path) -> str:
    """Return the text of a file, or of stdin (`-`). Raises ConfigError if it is unreadable or too long."""
    try:
        text = sys.stdin.buffer.read(_MOST_BYTES + 1) if str(file) == "-" else durable.read(file, _MOST_BYTES)
        if text is None:
            raise ConfigError(f"{file} cannot be read: there is no such file")
        if len(text) > _MOST_BYTES:
            raise ConfigError(f"{file} is larger than {_MOST_BYTES} bytes: it is no calibration")
        return text.decode()
    except (OSError, ValueError) as error:  # also a FIFO, for whose writer it would wait
        why = error.strerror if isinstance(error, OSError) else error
        raise ConfigError(f"{file} cannot be read: {why}") from error


def change_of(servo: ServoMapping) -> wire.ServoChange:
    """Return the change that gives a servo this calibration."""
    return wire.ServoChange(**servo.report.model_dump())


def _faults(error: ValidationError) -> str:
    """Place and fault of each, without the input: that may be a private file."""
    faults = error.errors(include_url=False, include_context=False, include_input=False)
    return "; ".join(": ".join((*map(str, each["loc"]), each["msg"])) for each in faults)


def _row(servo: ServoMapping) -> str:
    """One servo's trim, direction and limits, in columns."""
    trim = f"{servo.trim_cdeg / 100:+.2f}" if servo != AS_DRAWN else "0.00"
    way = "inverted" if servo.inverted else "as drawn"
    return f"{trim:>8}  {way:<9}  {_angle(servo.min_cdeg)}  {_angle(servo.max_cdeg)}"


def landing(connect: Connection, legs: Sequence[int], *, agreed: bool) -> int:
    """Make the running servos' angles their landing pose. `legs`: empty for all. Returns the exit code."""
    with connect() as client:
        state, calibration = client.state(), calibration_of(client.calibration())
        if state.calibration.fault is not None:
            say(
                f"the robot's calibration cannot be used, so no servo starts: {state.calibration.fault}. "
                f"Import a good one, or accept the default in the guide: {command('calibrate')}"
            )
            return 1
        stand = standing(state, legs)
        if not stand:
            which = f"leg {', '.join(map(str, legs))}" if legs else "the robot"
            say(f"no servo of {which} runs, so its pose is unknown: make it stand, and repeat this command meanwhile")
            return 1
        say("servo  lands now at     stands at")
        for servo_id, angle_deg in stand.items():
            say(f"{servo_id:5}  {_angle(calibration.landing_cdeg.get(servo_id)):>12}  {angle_deg:12.2f}")
        others = sorted(calibration.landing_cdeg.keys() - stand.keys())
        if others:
            say(f"The others of the pose stay as they are: {', '.join(map(str, others))}.")
        if not agreed and not _agree("Is this the landing pose of these servos?"):
            return 1
        payload = calibration_payload(landing=stand, revision=calibration.revision)
        code = _change(client, "the landing pose is written", state, payload)
    if code == 0 and not state.watchdog.landing_ms:
        hint("The robot does not land yet: watchdog.landing_ms is 0 in the gateway's settings.")
    return code


def once_kept(client: Client, payload: Mapping[str, Any]) -> Ack:
    """Return the answer to this change. Raises GatewayError if the gateway runs, but its disk is slow, or hangs."""
    try:
        return client.ask(keys.CALIBRATION_CMD, payload)
    except UnansweredError as error:
        client.state()  # raises if nobody answers
        raise GatewayError(
            "the gateway runs, but its disk has not written the change yet. See in a few seconds if it is in force "
            f"({command('calibrate export')}). If the disk hangs, a second try reports that"
        ) from error


def standing(state: GatewayState, legs: Sequence[int] = ()) -> dict[int, float]:
    """Return the commanded angles (degrees) of the running servos of these legs (empty: of all), by id."""
    return {
        servo.id: centidegrees(servo.angle_deg) / 100
        for leg in state.legs
        for servo in leg.servos
        if (not legs or leg.leg in legs) and servo.running and servo.angle_deg is not None
    }


# ---- inside


def _change(client: Client, done: str, state: GatewayState, payload: Mapping[str, Any]) -> int:
    """Change the calibration, at once if nobody else drives, otherwise when the lease is free.

    It first tries without a lease: to acquire one would stop legs that somebody drives without it. The robot would
    fall.
    """
    try:
        ack = once_kept(client, payload)
        if ack.reason in (Reason.NOT_HOLDER, Reason.NO_LEASE):
            ack = _when_free(client, payload)
        ack.or_raise()
    except RejectedError as error:
        return reach.rejected(error)
    say(f"{done}: revision {client.calibration().revision}")
    if not state.calibration.kept:
        hint("The calibration is lost at the next boot: it is only in memory (state.path), or on a file system that")
        hint("a boot empties (docs/robot.md).")
    return 0


def _when_free(client: Client, payload: Mapping[str, Any]) -> Ack:
    """Change it once the driver has handed over or ended. Raises LeaseError after WAIT_S."""
    if (holder := client.state().lease.holder) is not None:
        hint(f"{holder} drives, and is asked for the lease. The change is written when the lease is free; the")
        hint(f"servos may be stopped by then. Waiting for up to {WAIT_S:g} s.")
    with client.lease(wait_s=WAIT_S, source=reach.me()):
        return once_kept(client, payload)


def _angle(cdeg: int | None) -> str:
    return " " * 9 if cdeg is None else f"{cdeg / 100:9.2f}"


def _agree(question: str) -> bool:
    if not sys.stdin.isatty():
        say(f"nothing is written: {NOBODY}")
        return False
    agreed = ask(f"{question} [y/N] ") in ("y", "yes")
    if not agreed:
        say("nothing is written")
    return agreed
