"""What the commands of the command line do, besides `run`'s service itself."""

import re
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from functools import partial
from pathlib import Path

from gateway import logs, service
from gateway.client import DEFAULT_ENDPOINT, Client, leg_payload, servo_payload
from gateway.errors import ConfigError
from gateway.protocol.frames import STOP, FrameError, OneLeg, OneServo, Op, stop_leg
from gateway.protocol.frames import decode as decode_frame
from gateway.settings import Settings
from schemas import keys
from schemas.robot import JOINTS, LEGS
from schemas.telemetry import Ack

HOLD_PERIOD_S = 0.05
"""A fifth of the default watchdog timeout."""

_FRAME_HEADERS = frozenset(frame.to_bytes()[:2] for frame in (stop_leg(1), OneServo(11, STOP)))
"""FRAME LEN and FRAME TYPE of the two frames that there are."""

_MAX_ECHO = 40
"""Characters of what was typed that are repeated."""

Connection = Callable[[], AbstractContextManager[Client]]


def say(text: str) -> None:
    """A line of result, on stdout."""
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


def hint(text: str) -> None:
    """A line for the person, on stderr, out of the way of pipes."""
    sys.stderr.write(f"{text}\n")
    sys.stderr.flush()


def run(settings: Settings, *, simulated: bool) -> None:
    """Run the service and, once it is ready, say where it is and what to try next."""
    logs.set_up(settings.log)

    def ready() -> None:
        robot = "a simulated controller" if simulated else settings.spi.device
        where = ", ".join(settings.zenoh.listen) or settings.zenoh.config
        say(f"hexapod-gateway is ready: {where} → {robot} ({settings.spi.framing})")
        say(f"Try, in a second terminal: {_this_command()} send leg 3 start 90 45 120 --hold 5{_connect_option(settings)}")

    service.run(settings, simulated=simulated, on_ready=ready)


def _this_command() -> str:
    """How this program was called, so that a line can be copied."""
    return "hexapod-gateway" if sys.argv[0].endswith("__main__.py") else sys.argv[0]


def _connect_option(settings: Settings) -> str:
    """What a client on this machine must add to reach this service."""
    listen = settings.zenoh.listen
    return f" --connect {listen[0]}" if listen and DEFAULT_ENDPOINT not in listen else ""


def stop_servos(settings: Settings) -> None:
    """Stop all six legs over SPI."""
    service.stop_servos(settings)
    say(f"Stop written to all six legs, {1 + settings.watchdog.repeats} times each, on {settings.spi.device}")


def connection(connect: str | None, zenoh_config: Path | None, timeout_s: float) -> Connection:
    """How to reach the gateway: the endpoint given, or the file's, or this machine's."""
    if connect is None and zenoh_config is None:
        connect = DEFAULT_ENDPOINT
    return partial(Client, connect, zenoh_config=zenoh_config, source="hexapod-gateway send", timeout_s=timeout_s)


def send_leg(connect: Connection, leg: int, op: str, angles_deg: Sequence[float], *, hold_s: float) -> int:
    """Send a leg's command; see `_send`."""
    wanted = 0 if op == "stop" else len(JOINTS)
    _check_op(op)
    if len(angles_deg) != wanted:
        raise ConfigError(
            f"{op} takes {wanted or 'no'} angles, and there are {len(angles_deg)}; "
            f"for example: send leg {leg} start 90 45 120"
        )
    return _send(connect, keys.leg_command(leg), leg_payload(op, tuple(angles_deg)), moves=op != "stop", hold_s=hold_s)


def send_servo(connect: Connection, servo_id: int, op: str, angle_deg: float | None, *, hold_s: float) -> int:
    """Send a servo's command; see `_send`."""
    _check_op(op)
    if (angle_deg is None) != (op == "stop"):
        raise ConfigError(f"{op} takes {'no' if op == 'stop' else 'one'} angle; for example: send servo 32 start 90")
    try:
        key = keys.servo_command(servo_id)
    except ValueError as error:
        raise ConfigError(str(error)) from error
    return _send(connect, key, servo_payload(op, angle_deg), moves=op != "stop", hold_s=hold_s)


def send_stop(connect: Connection) -> int:
    """Stop all six legs."""
    with connect() as client:
        return _report(client.stop(), "all six legs are stopped")


def _send(connect: Connection, key: str, payload: dict[str, object], *, moves: bool, hold_s: float) -> int:
    """Send an acknowledged command, repeat it for `hold_s`, and say what became of it. Returns the exit code."""
    with connect() as client:
        code = _report(client.ask(key, payload), "accepted")
        end = time.monotonic() + hold_s
        while code == 0 and time.monotonic() < end:
            time.sleep(HOLD_PERIOD_S)
            ack = client.ask(key, payload)
            if not ack.accepted:
                code = _report(ack, "")
        if code == 0 and moves:
            timeout_ms = client.state().watchdog.timeout_ms
            hint(
                f"Held for {hold_s:g} s; nothing more is sent now, and the watchdog stops it after {timeout_ms:g} ms."
                if hold_s
                else f"The watchdog stops it {timeout_ms:g} ms after a command; --hold S repeats it for S seconds."
            )
        return code


def estop(connect: Connection) -> int:
    """Engage the emergency stop."""
    with connect() as client:
        ack = client.estop()
    if ack.stop_frames is not None and ack.stop_frames >= len(LEGS):
        say(f"stopped: {ack.stop_frames} Stop frames written within {ack.latency_us:.0f} µs of the request")
        hint("All commands are refused until `hexapod-gateway reset`.")
        return 0
    say(f"latched, but only {ack.stop_frames} of {len(LEGS)} Stop frames were written: switch the servos' power off")
    return 1


def reset(connect: Connection) -> int:
    """Leave the emergency stop."""
    with connect() as client:
        return _report(client.reset(), "reset; nothing moves until it is started again")


def decode(hex_bytes: Sequence[str]) -> int:
    """Explain frames, one line each."""
    try:
        data = b"".join(map(_bytes, " ".join(hex_bytes).replace(",", " ").split()))
    except ValueError as error:
        say(str(error))
        return 1
    for frame in _frames(data):
        try:
            say(_explain(frame))
        except FrameError as error:
            say(f"{frame.hex(' ') or 'nothing'}: not legal: {error}")
            return 1
    return 0


def _bytes(word: str) -> bytes:
    """The bytes of `06`, `0x06`, `0x6` or `060220020000`. Raises ValueError, also for half a byte."""
    if re.fullmatch(r"0x[0-9a-fA-F]", word):
        word = f"0{word[2:]}"
    digits = word.removeprefix("0x")
    if not re.fullmatch(r"[0-9a-fA-F]+", digits):
        raise ValueError(f"{_short(word)} is not hexadecimal")
    if len(digits) % 2:
        raise ValueError(f"{_short(word)} ends with half a byte; a byte has two digits, such as 06")
    return bytes.fromhex(digits)


def _short(word: str) -> str:
    shown = ascii(word)
    return shown if len(shown) <= _MAX_ECHO else shown[:_MAX_ECHO] + "…"


def _frames(data: bytes) -> Iterator[bytes]:
    """Cut legal frames off the front while there are any; what is left is one piece, to be explained as it is."""
    while data[:2] in _FRAME_HEADERS and len(data) > data[0]:
        yield data[: data[0]]
        data = data[data[0] :]
    yield data


def _explain(data: bytes) -> str:
    frame = decode_frame(data)
    name = f"ONE LEG, leg {frame.leg}" if isinstance(frame, OneLeg) else "ONE SERVO"
    ops = (
        f"servo {servo_id} {command.op.name.lower()}"
        + ("" if command.op is Op.STOP else f" {command.angle_cdeg // 100}.{command.angle_cdeg % 100:02}°")
        for servo_id, command in frame.servos
    )
    return f"{data.hex(' ')}: {name}: {', '.join(ops)}"


def _check_op(op: str) -> None:
    if op not in ("start", "set", "stop"):
        raise ConfigError(f"{op} is no operation; it is start, set or stop")


def _report(ack: Ack, accepted: str) -> int:
    if ack.accepted:
        say(accepted + (" (a newer command replaced it while it waited)" if ack.coalesced else ""))
        return 0
    say(f"refused: {ack.reason}: {ack.detail}")
    return 1
