"""`send`, `estop` and `reset`: one acknowledged command each, through a running gateway."""

import time
from collections.abc import Callable, Sequence
from contextlib import nullcontext, suppress
from typing import Any, Final

from gateway.errors import ConfigError, GatewayError, LeaseError
from gateway.people.client import pace
from gateway.people.client.blocking import Client
from gateway.people.client.lease_requests import Identity
from gateway.people.client.payloads import leg_payload, legs_payload, servo_payload
from gateway.people.commands import reach
from gateway.people.commands.options import Reach
from gateway.people.commands.reach import Connection, me
from gateway.people.terminal import hint, say
from gateway.people.watching.dangers import PowerAlarm, confirmed_off
from gateway.words.own_command import command
from gateway.zenoh.config import client_config
from schemas import keys
from schemas.ack import Ack
from schemas.gateway_state import GatewayState, WatchdogReport
from schemas.robot import JOINTS, LEGS, SERVO_IDS
from schemas.words import Mode, Reason

HOLD_PERIOD_S = 0.05
"""A fifth of the default watchdog timeout."""


_MOST_PERSON: Final = 40
"""Most characters of the person's name; a source may have 64."""


def connection(by: Reach, command: str = "send") -> Connection:
    """Return a connection whose commands have the sender's name: the certificate's person, or this machine's user."""
    person = me()
    if by.zenoh_config is not None:
        identity = Identity.of(client_config(by.connect, by.zenoh_config))
        with suppress(ConfigError):
            person = identity.person() if identity.proves else person
    return by.connection(f"{person[:_MOST_PERSON]} (hexapod-gateway {command})")


def send(connect: Connection, kind: str, number: int, op: str, angles_deg: Sequence[float], *, hold_s: float) -> int:
    """Start, set or stop (`op`) a `leg`, a `servo` or all `legs` (`kind`), repeat it for `hold_s`, print the result.

    Returns the exit code. Raises ConfigError for another number of angles, or an id that does not exist.
    """
    counts, takes, example = ({0}, "no angles", "") if op == "stop" else _TAKES[kind]
    if len(angles_deg) not in counts:
        shown = command(f"send {kind}{f' {number}' if number else ''} {op}{example}")
        raise ConfigError(f"{op} takes {takes}, and there are {len(angles_deg)}; for example: {shown}")
    try:
        key = _KEYS[kind](number)
    except ValueError as error:
        raise ConfigError(str(error)) from error
    if pace.like_radians(angles_deg):
        hint("Angles are in degrees, 0 to 180. These look like radians.")
    payload, moves = _payload(kind, op, tuple(angles_deg)), op != "stop"
    # A repeated start would undo somebody else's Stop.
    again = _payload(kind, "set", tuple(angles_deg)) if moves else payload

    def hold(client: Client) -> int:
        try:
            with client.lease(source=me()) if moves and hold_s else nullcontext():
                code = command_report(client.ask(key, payload, again=not moves), "accepted", client.state)
                end = time.monotonic() + hold_s
                while code == 0 and time.monotonic() < end:
                    time.sleep(HOLD_PERIOD_S)
                    ack = client.ask(key, again)
                    if not ack.accepted:
                        code = reach.rejected(ack)
                if code == 0 and moves:
                    _hint_watchdog(client.state().watchdog, hold_s)
        except LeaseError as error:
            code = reach.rejected(error)
        return code

    return _ask(connect, key, hold)


_KEYS: Final[dict[str, Callable[[int], str]]] = {
    "leg": keys.leg_command,
    "legs": lambda _: keys.LEGS_COMMAND,
    "servo": keys.servo_command,
}
_TAKES: Final = {
    "leg": ({len(JOINTS)}, "3 angles", " 90 45 120"),
    "legs": ({len(JOINTS), len(SERVO_IDS)}, "3 angles, or 18", " 90 45 120"),
    "servo": ({1}, "one angle", " 90"),
}
"""How many angles a start or set takes, in words, and an example."""


def _payload(kind: str, op: str, angles_deg: tuple[float, ...]) -> dict[str, Any]:
    if kind == "legs":
        return legs_payload(op, dict.fromkeys(LEGS, angles_deg) if len(angles_deg) <= len(JOINTS) else angles_deg)
    return leg_payload(op, angles_deg) if kind == "leg" else servo_payload(op, next(iter(angles_deg), None))


def _hint_watchdog(watchdog: WatchdogReport, hold_s: float) -> None:
    timeout = f"{watchdog.timeout_ms:g} ms"
    lands = f", once the robot has landed in {watchdog.landing_ms:g} ms" if watchdog.landing_ms else ""
    hint(
        f"Held for {hold_s:g} s. The watchdog stops it after {timeout}{lands}."
        if hold_s
        else f"The watchdog stops it {timeout} after a command{lands}; --hold S repeats it for S seconds."
    )


def stop(connect: Connection) -> int:
    """Stop all six legs. Returns the exit code."""

    def end(client: Client) -> int:
        ack = client.stop()
        if ack.reason == Reason.ESTOPPED and not any(leg.running for leg in client.state().legs):
            say("all six legs are stopped already, by the emergency stop")
            hint(reach.until_reset())
            return 0
        return command_report(ack, "all six legs are stopped", client.state)

    return _ask(connect, keys.LEGS_COMMAND, end)


def estop(connect: Connection) -> int:
    """Engage the emergency stop. Returns 0 if all six Stops were written and a power board, if any, confirmed."""
    return _ask(connect, keys.ESTOP, lambda client: estop_report(client.estop(), client.state))


def reset(connect: Connection) -> int:
    """End the latest emergency stop. Returns the exit code."""

    def end(client: Client) -> int:
        state = client.state()
        was = "reset" if state.mode == Mode.ESTOPPED else "no emergency stop was engaged"
        ack = client.ask(keys.RESET, {"estop": state.estop})
        return command_report(ack, f"{was}; nothing moves until it is started again", client.state)

    return _ask(connect, keys.RESET, end)


def _ask(connect: Connection, key: str, ask: Callable[[Client], int]) -> int:
    """Return the exit code of `ask`. After its result, which must not wait, warn if other programs answer on `key`."""
    with connect() as client:
        code = ask(client)
        reach.warn_of_others(client, key, hint)
        return code


def estop_report(ack: Ack, fetch_state: Callable[[], GatewayState]) -> int:
    """Print what an emergency stop did. Return the exit code. `fetch_state` may raise GatewayError."""
    alarm = _alarm(ack, fetch_state)
    stopped = ack.stop_frames is not None and ack.stop_frames >= len(LEGS)
    if stopped:
        power = confirmed_off(ack)
        say(f"stopped: {ack.stop_frames} Stop frames written within {ack.latency_us:.0f} µs of the request{power}")
        hint(reach.until_reset())
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


def command_report(ack: Ack, accepted: str, fetch_state: Callable[[], GatewayState]) -> int:
    """Print the result of a command: `accepted` if it was. Return the exit code."""
    if ack.accepted:
        replaced = " (a newer command replaced it while it waited)" if ack.coalesced else ""
        say(f"{accepted}{replaced}{confirmed_off(ack)}")
        if alarm := _alarm(ack, fetch_state):
            say(alarm)
        return 1 if alarm else 0
    return reach.rejected(ack)
