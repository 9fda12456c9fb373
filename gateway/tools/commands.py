"""What the commands of the command line do, besides `run`'s service itself."""

import sys
import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from functools import partial
from pathlib import Path

from gateway import logs, service
from gateway.client import DEFAULT_ENDPOINT, Client, leg_payload, servo_payload
from gateway.errors import ConfigError
from gateway.protocol.frames import FrameError, OneLeg, Op
from gateway.protocol.frames import decode as decode_frame
from gateway.settings import Settings
from schemas import keys
from schemas.telemetry import Ack

HOLD_PERIOD_S = 0.05
"""A fifth of the default watchdog timeout."""

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
        say(
            f"hexapod-gateway is ready: {', '.join(settings.zenoh.listen) or settings.zenoh.config} → {robot} ({settings.spi.framing})"
        )
        connect = (
            ""
            if DEFAULT_ENDPOINT in settings.zenoh.listen
            else f" --connect {settings.zenoh.listen[0]}"
            if settings.zenoh.listen
            else ""
        )
        say(f"Try, in a second terminal: {Path(sys.argv[0])} send leg 3 start 90 45 120 --hold 5{connect}")

    service.run(settings, simulated=simulated, on_ready=ready)


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
    wanted = 0 if op == "stop" else len(keys.JOINTS)
    _check_op(op)
    if len(angles_deg) != wanted:
        raise ConfigError(
            f"{op} takes {wanted or 'no'} angles, and there are {len(angles_deg)}; for example: send leg {leg} start 90 45 120"
        )
    return _send(connect, keys.leg_command(leg), leg_payload(op, tuple(angles_deg)), hold_s=hold_s)


def send_servo(connect: Connection, servo_id: int, op: str, angle_deg: float | None, *, hold_s: float) -> int:
    """Send a servo's command; see `_send`."""
    _check_op(op)
    if (angle_deg is None) != (op == "stop"):
        raise ConfigError(f"{op} takes {'no' if op == 'stop' else 'one'} angle; for example: send servo 32 start 90")
    try:
        key = keys.servo_command(servo_id)
    except ValueError as error:
        raise ConfigError(str(error)) from error
    return _send(connect, key, servo_payload(op, angle_deg), hold_s=hold_s)


def send_stop(connect: Connection) -> int:
    """Stop all six legs."""
    with connect() as client:
        return _report(client.stop(), "all six legs are stopped")


def _send(connect: Connection, key: str, payload: dict[str, object], *, hold_s: float) -> int:
    """Send an acknowledged command, repeat it for `hold_s`, and say what became of it. Returns the exit code."""
    with connect() as client:
        code = _report(client.ask(key, payload), "accepted")
        moves = '"stop"' not in str(payload).replace("'", '"')
        end = time.monotonic() + hold_s
        while code == 0 and time.monotonic() < end:
            time.sleep(HOLD_PERIOD_S)
            ack = client.ask(key, payload)
            if not ack.accepted:
                code = _report(ack, "")
        if code == 0 and moves:
            timeout_ms = client.state().watchdog.timeout_ms
            if hold_s:
                hint(
                    f"Held for {hold_s:g} s; now nothing more is sent, and the watchdog stops it after {timeout_ms:g} ms."
                )
            else:
                hint(
                    f"The watchdog stops it after {timeout_ms:g} ms without a command; --hold S keeps it for S seconds."
                )
        return code


def estop(connect: Connection) -> int:
    """Engage the emergency stop."""
    with connect() as client:
        ack = client.estop()
    if ack.stop_frames is not None and ack.stop_frames >= len(keys.LEGS):
        say(f"stopped: {ack.stop_frames} Stop frames written within {ack.latency_us:.0f} µs of the request")
        hint("All commands are refused until `hexapod-gateway reset`.")
        return 0
    say(
        f"latched, but only {ack.stop_frames} of {len(keys.LEGS)} Stop frames could be written: switch the servos' power off"
    )
    return 1


def reset(connect: Connection) -> int:
    """Leave the emergency stop."""
    with connect() as client:
        return _report(client.reset(), "reset; nothing moves until it is started again")


def decode(hex_bytes: Sequence[str]) -> int:
    """Explain frames, one line each."""
    text = "".join(hex_bytes).replace(" ", "").replace(",", "").replace("0x", "")
    try:
        data = bytes.fromhex(text)
    except ValueError as error:
        say(f"not hexadecimal: {error}")
        return 1
    while data:
        # A frame begins with its own length; the last one takes what is left, so that nothing goes unexplained.
        length = (
            data[0]
            if 0 < data[0] < len(data) and data[0] in (6, 14) and data[1] in (1, 2) and len(data) - data[0] >= 6
            else len(data)
        )
        frame, data = data[:length], data[length:]
        try:
            say(_explain(frame))
        except FrameError as error:
            say(f"{frame.hex(' ')}: not legal: {error}")
            return 1
    return 0


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
