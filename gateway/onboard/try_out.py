"""What `make run` starts: a simulated robot with a black box, and the console.

Each is a process of its own, as on a robot. Both end on Ctrl-C or SIGTERM, or when the gateway ends. The end of the
console does not end the gateway. The console starts when the gateway is ready, so that its link is printed last.
"""

import errno
import os
import socket
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Final

from gateway.errors import ConfigError, ZenohError
from gateway.people.terminal import hint, on_end_signals, say
from gateway.robot import settings
from gateway.robot.blackbox.ring import tried
from gateway.robot.zenoh_io.session import bind_fault
from gateway.words import own_command
from gateway.words.own_command import command
from gateway.zenoh.config import why_not_opened

NO_CONSOLE: Final = "no"
_COMMAND: Final = Path(sys.executable).with_name("hexapod-gateway")
_POLL_S: Final = 0.1
"""The period of checks whether a gateway has ended before it is ready."""
_END_S: Final = 5.0


def try_out(console: Sequence[str]) -> int:
    """Run both until the gateway has ended. Return its exit code. `console`: the console's options, or `no`."""
    children: list[subprocess.Popen[bytes]] = []
    ended = False
    for each in _listens_on():  # first: a second gateway would warn of the state and black box that the first holds
        if (fault := bind_fault(each)) is not None and fault.errno == errno.EADDRINUSE:
            hint(f"hexapod-gateway: {why_not_opened(str(fault), [each])}")
            return ZenohError.exit_code
    environment = _environment(os.environ)
    own_command.reach_by(connect=environment.get(own_command.CONNECT_VARIABLE))

    def start(*arguments: str, **more: str) -> subprocess.Popen[bytes]:
        child = subprocess.Popen([_command(), *arguments], env={**environment, **more})
        children.append(child)
        if ended:
            child.terminate()
        return child

    def end() -> None:
        nonlocal ended
        ended = True
        for child in children:
            with suppress(ProcessLookupError):
                child.terminate()

    with ExitStack() as stack:
        stack.enter_context(on_end_signals(end))
        folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="hexapod-"))
        notified = stack.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM))
        notified.bind(f"{folder}/notify")
        notified.settimeout(_POLL_S)
        gateway = start("run", "--sim", NOTIFY_SOCKET=f"{folder}/notify")
        if _is_ready(gateway, notified) and not ended:
            say(f"or, from the keyboard: {command('walk')}")
            if list(console) != [NO_CONSOLE]:
                start("console", *console)
        status = gateway.wait()
        end()
        for child in children:
            try:
                child.wait(_END_S)
            except subprocess.TimeoutExpired:
                child.kill()
    return status if status >= 0 else 128 - status


def _is_ready(gateway: subprocess.Popen[bytes], notified: socket.socket) -> bool:
    """Wait until the gateway reports to systemd that it is ready. Return False if it ends before."""
    while gateway.poll() is None:
        with suppress(TimeoutError):
            if b"READY=1" in notified.recv(4096):
                return True
    return False


def _environment(variables: Mapping[str, str]) -> dict[str, str]:
    """`variables` with defaults for what is recorded, where, and where the gateway listens."""
    if "HEXAPOD_STATE__PATH" not in variables:
        tried().mkdir(mode=0o700, parents=True, exist_ok=True)
    found = {"HEXAPOD_STATE__PATH": str(tried()), "HEXAPOD_TELEMETRY__FRAMES": "true", **variables}
    endpoint = own_command.plain(_listens_on())
    if endpoint not in (None, own_command.DEFAULT_ENDPOINT) or own_command.CONNECT_VARIABLE in variables:
        found[own_command.CONNECT_VARIABLE] = endpoint or own_command.DEFAULT_ENDPOINT
    return found


def _listens_on() -> Sequence[str]:
    """Return the gateway's endpoints; none if its settings are wrong, which its process reports."""
    with suppress(ConfigError):
        return settings.load(None, simulated=True).zenoh.listen
    return ()


def _command() -> str:
    """Return the command relative to the working directory, so that printed commands can be copied."""
    return str(_COMMAND.relative_to(Path.cwd()) if _COMMAND.is_relative_to(Path.cwd()) else _COMMAND)


if __name__ == "__main__":
    options = sys.argv[1:]
    sys.argv = [_command()]  # the name in messages
    sys.exit(try_out(options))
