"""Starts the service and the console."""

import os
import shutil
import time
from functools import partial
from typing import Final

from gateway.errors import GatewayError
from gateway.onboard.setup import configuration
from gateway.onboard.setup.machine import ETC, KEPT_CONFIGURATION, SERVICE, Machine
from gateway.people.terminal import say

CONSOLE: Final = "hexapod-console"
_CONSOLE_OPTIONS: Final = f"/etc/{CONSOLE}/console.conf"
_CONSOLE_STATE: Final = f"/var/lib/{CONSOLE}"
_LISTENS_S: Final = 60
"""The longest wait for the console to listen: on a busy Pi it needs some seconds."""
_PAUSE_S: Final = 0.2

_PACKAGED: Final = f"/usr/lib/systemd/system/{SERVICE}.service"
_FORMER: Final = (
    *(f"/etc/systemd/system/{unit}" for unit in (f"{SERVICE}.service", f"{CONSOLE}.service", f"{CONSOLE}.socket")),
    f"/etc/udev/rules.d/60-{SERVICE}.rules",
    f"/usr/local/bin/{SERVICE}",
    f"/opt/{SERVICE}",
)
"""Files of the installer before the package. systemd and the shell would prefer them to the package's files."""


def remove_former(machine: Machine) -> None:
    """Remove the files of the former installer, if the package is installed. Configuration and state stay."""
    found = [each for each in _FORMER if os.path.lexists(machine.path(each))]
    if not found or not machine.path(_PACKAGED).exists():
        return
    machine.will_restart()
    for each in found:
        path = machine.path(each)
        remove = partial(shutil.rmtree, path) if path.is_dir() and not path.is_symlink() else path.unlink
        machine.change(f"remove {each}, of the former installer", remove)
    if not machine.dry:
        machine.systemctl("daemon-reload")


def start(machine: Machine, device: str) -> None:
    """Run the service with the present setup. Raises GatewayError."""
    machine.enable(SERVICE)
    simulated = "--sim" in machine.show(SERVICE, "Environment")
    if machine.is_active(SERVICE):
        if machine.restart_due or _is_outdated(machine):
            machine.check_no_servo_runs()
            machine.change("restart the service: all legs stop", lambda: _start(machine, SERVICE))
        else:
            say("the service runs with this setup")
    elif machine.path(device).exists() or simulated:
        machine.change("start the service", lambda: _start(machine, SERVICE))
    elif machine.reboot_due:
        say("the service starts with the reboot")
    else:
        say(f"not started: there is no {device}; once there is: sudo systemctl start {SERVICE}")


def _is_outdated(machine: Machine) -> bool:
    """Return whether a file has changed since the service's start, such as by an interrupted `setup`."""
    kept = machine.path(KEPT_CONFIGURATION)
    if not kept.exists():
        return False
    if machine.read(KEPT_CONFIGURATION) != machine.read(configuration.FILE):
        return True
    begun = kept.stat().st_mtime_ns
    return any(each.stat().st_mtime_ns > begun for each in machine.path(f"{ETC}/zenoh").glob("*"))


def _start(machine: Machine, unit: str) -> None:
    """Start a unit, also after so many failed starts that systemd attempts no other."""
    machine.systemctl("reset-failed", unit, check=False)
    try:
        machine.systemctl("restart", unit)
    except GatewayError as error:
        why = _last_words(machine, unit) or error
        raise GatewayError(f"{unit} does not start: {why}; journalctl -u {unit} shows why") from None


def _last_words(machine: Machine, unit: str) -> str:
    shown = machine.run(["journalctl", f"--unit={unit}", "--lines=30", "--output=cat"]).stdout
    found = [line for line in shown.splitlines() if line.startswith(f"{SERVICE}: ")]
    return found[-1].removeprefix(f"{SERVICE}: ") if found else ""


def start_console(machine: Machine) -> None:
    """Run the web console as its own service, on loopback unless its socket unit names another address."""
    readable = machine.let_read(f"/etc/{CONSOLE}", CONSOLE)
    if machine.read(_CONSOLE_OPTIONS) is None:
        machine.put(_CONSOLE_OPTIONS, configuration.shipped("systemd/console.conf"), group=CONSOLE)
    machine.enable(f"{CONSOLE}.service", f"{CONSOLE}.socket")
    if machine.is_active(f"{CONSOLE}.service") and not readable:
        say("the console runs")
        return
    if machine.is_active(f"{CONSOLE}.service"):
        machine.check_no_servo_runs()  # its pages may drive
    sentence = "start the console; a link for a browser: sudo hexapod-gateway console --link"
    machine.change(sentence, lambda: _begin(machine))


def _begin(machine: Machine) -> None:
    """Start the console, and wait until it listens: its process may start and then find an unreadable file."""
    since_s = time.time() - 1
    try:
        machine.systemctl("start", f"{CONSOLE}.socket")
    except GatewayError:
        fix = f"sudo ss -ltnp names it; for another port: sudo systemctl edit {CONSOLE}.socket"
        raise GatewayError(f"another program has the console's port: {fix}") from None
    _start(machine, f"{CONSOLE}.service")
    until_s = time.monotonic() + _LISTENS_S
    while not any(each.stat().st_mtime > since_s for each in machine.path(_CONSOLE_STATE).glob("console-*.json")):
        if not machine.is_active(f"{CONSOLE}.service"):
            why = _last_words(machine, CONSOLE)
            raise GatewayError(f"the console started and ended: {why}; journalctl -u {CONSOLE}")
        if time.monotonic() > until_s:
            raise GatewayError(f"the console does not listen after {_LISTENS_S} s: journalctl -u {CONSOLE} shows why")
        time.sleep(_PAUSE_S)
