"""`send`, `estop` and `reset`: one acknowledged command each, through a running gateway."""

import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

from gateway.errors import ConfigError, GatewayError, LeaseError
from gateway.own_command import command
from gateway.people.client.blocking import Client, several_answer
from gateway.people.client.dangers import PowerAlarm, confirmed_off
from gateway.people.client.payloads import leg_payload, legs_payload, servo_payload
from gateway.people.client.requests import Identity
from gateway.people.commands import reach
from gateway.people.commands.options import Reach
from gateway.people.commands.reach import Connection, me
from gateway.people.terminal import hint, say
from gateway.zenoh_config import client_config
from schemas import keys
from schemas.robot import JOINTS, LEGS, SERVO_IDS
from schemas.telemetry import Ack, GatewayState, Mode

HOLD_PERIOD_S = 0.05
"""A fifth of the default watchdog timeout."""

_OTHERS_S = 0.2
"""How long a command waits for programs that have neither replied nor declined."""

_MOST_PERSON: Final = 40
"""Most characters of the person's name; a source may have 64."""


def connection(by: Reach, command: str = "send") -> Connection:
    """Return a connection whose commands have the sender's name in events and states."""
    person = person_of(by.connect, by.zenoh_config)[:_MOST_PERSON]
    return by.connection(f"{person} (hexapod-gateway {command})")


def person_of(connect: str | None, zenoh_config: Path | None) -> str:
    """Return the certificate's person; without one, this machine's user."""
    if zenoh_config is not None:
        identity = Identity.of(client_config(connect, zenoh_config))
        if identity.proves:
            with suppress(ConfigError):
                return identity.person()
    return me()


def send_leg(connect: Connection, leg: int, op: str, angles_deg: Sequence[float], *, hold_s: float) -> int:
    """Start, set or stop (`op`) a leg. Returns the exit code. Raises ConfigError for another number of angles."""
    _check_count(f"leg {leg}", op, len(angles_deg), {len(JOINTS)}, "3 angles")
    return _send(connect, keys.leg_command(leg), leg_payload(op, tuple(angles_deg)), moves=op != "stop", hold_s=hold_s)


def send_legs(connect: Connection, op: str, angles_deg: Sequence[float], *, hold_s: float) -> int:
    """Start, set or stop all six legs, with three angles for each leg or all 18. Returns and raises as `send_leg`."""
    _check_count("legs", op, len(angles_deg), {len(JOINTS), len(SERVO_IDS)}, "3 angles, or 18")
    pose = dict.fromkeys(LEGS, tuple(angles_deg)) if len(angles_deg) <= len(JOINTS) else list(angles_deg)
    return _send(connect, keys.LEGS_COMMAND, legs_payload(op, pose), moves=op != "stop", hold_s=hold_s)


def send_servo(connect: Connection, servo_id: int, op: str, angle_deg: float | None, *, hold_s: float) -> int:
    """Start, set or stop a servo. Returns and raises as `send_leg`, also for an id that does not exist."""
    _check_count(f"servo {servo_id}", op, int(angle_deg is not None), {1}, "one angle", " 90")
    try:
        key = keys.servo_command(servo_id)
    except ValueError as error:
        raise ConfigError(str(error)) from error
    return _send(connect, key, servo_payload(op, angle_deg), moves=op != "stop", hold_s=hold_s)


def _check_count(what: str, op: str, given: int, counts: set[int], takes: str, example: str = " 90 45 120") -> None:
    """Raise ConfigError for another number of angles than `op` takes."""
    if op == "stop":
        counts, takes, example = {0}, "no angles", ""
    if given not in counts:
        shown = command(f"send {what} {op}{example}")
        raise ConfigError(f"{op} takes {takes}, and there are {given}; for example: {shown}")


def send_stop(connect: Connection) -> int:
    """Stop all six legs. Returns the exit code."""
    with connect() as client:
        code = command_report(client.stop(), "all six legs are stopped", client.state)
        _warn_of_others(client, keys.LEGS_COMMAND)
        return code


def _send(connect: Connection, key: str, payload: dict[str, object], *, moves: bool, hold_s: float) -> int:
    """Send an acknowledged command, repeat it for `hold_s`, and print the result. Returns the exit code."""
    with connect() as client:
        try:
            with reach.drives(client, hold_s, moves=moves):
                code = _send_for(client, key, payload, moves=moves, hold_s=hold_s)
        except LeaseError as error:
            code = reach.rejected(error)
        _warn_of_others(client, key)
        return code


def _send_for(client: Client, key: str, payload: dict[str, object], *, moves: bool, hold_s: float) -> int:
    code = command_report(client.ask(key, payload, again=not moves), "accepted", client.state)
    end = time.monotonic() + hold_s
    again = _set_instead_of_start(payload)
    while code == 0 and time.monotonic() < end:
        time.sleep(HOLD_PERIOD_S)
        ack = client.ask(key, again)
        if not ack.accepted:
            code = command_report(ack, "", client.state)
    if code == 0 and moves:
        watchdog = client.state().watchdog
        timeout = f"{watchdog.timeout_ms:g} ms"
        lands = f", once the robot has landed in {watchdog.landing_ms:g} ms" if watchdog.landing_ms else ""
        hint(
            f"Held for {hold_s:g} s. The watchdog stops it after {timeout}{lands}."
            if hold_s
            else f"The watchdog stops it {timeout} after a command{lands}; --hold S repeats it for S seconds."
        )
    return code


def _set_instead_of_start(payload: Any) -> Any:
    """The payload with sets for its starts: a repeated start would undo somebody else's Stop."""
    if isinstance(payload, list):
        return [_set_instead_of_start(each) for each in payload]
    if isinstance(payload, dict):
        return {name: _set_instead_of_start(each) for name, each in payload.items()}
    return "set" if payload == "start" else payload


def estop(connect: Connection) -> int:
    """Engage the emergency stop. Returns 0 if all six Stops were written and a power board, if any, confirmed."""
    with connect() as client:
        code = estop_report(client.estop(), client.state)
        _warn_of_others(client, keys.ESTOP)
    return code


def estop_report(ack: Ack, fetch_state: Callable[[], GatewayState]) -> int:
    """Print what an emergency stop did. Return the exit code. `fetch_state` may raise GatewayError."""
    alarm = _alarm(ack, fetch_state)
    stopped = ack.stop_frames is not None and ack.stop_frames >= len(LEGS)
    if stopped:
        power = confirmed_off(ack)
        say(f"stopped: {ack.stop_frames} Stop frames written within {ack.latency_us:.0f} µs of the request{power}")
        hint(f"All commands are rejected until `{command('reset')}`.")
    else:
        written = f"only {ack.stop_frames} of {len(LEGS)} Stop frames were written"
        say(f"latched, but {written}: switch the servos' power off")
    if alarm:
        say(alarm)
    return 0 if stopped and not alarm else 1


def _alarm(ack: Ack, fetch_state: Callable[[], GatewayState]) -> str:
    """Return the sentence about a Stop that the power board does not confirm; "" if the supply is to stay on.

    The answer to a Stop that leaves the supply on has no confirmation either: the state shows what is to be off.
    """
    alarm = PowerAlarm()
    alarm.answered(ack)
    if alarm.sentence:
        with suppress(GatewayError):
            alarm.received_state(fetch_state(), 0)
    return alarm.sentence


def reset(connect: Connection) -> int:
    """End the latest emergency stop. Returns the exit code."""
    with connect() as client:
        state = client.state()
        was = "reset" if state.mode == Mode.ESTOPPED else "no emergency stop was engaged"
        ack = client.ask(keys.RESET, {"estop": state.estop})
        code = command_report(ack, f"{was}; nothing moves until it is started again", client.state)
        _warn_of_others(client, keys.RESET)
        return code


def _warn_of_others(client: Client, key: str) -> None:
    """Warn if other programs answer, too. Call it after the result, which must not wait."""
    count = len(client.answerers(key, _OTHERS_S))
    if count > 1:
        hint(several_answer(count, key))


def command_report(ack: Ack, accepted: str, fetch_state: Callable[[], GatewayState]) -> int:
    """Print the result of a command: `accepted` if it was. Return the exit code."""
    if ack.accepted:
        replaced = " (a newer command replaced it while it waited)" if ack.coalesced else ""
        say(f"{accepted}{replaced}{confirmed_off(ack)}")
        if alarm := _alarm(ack, fetch_state):
            say(alarm)
        return 1 if alarm else 0
    return reach.rejected(ack)
