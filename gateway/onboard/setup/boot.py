"""SPI and UARTs in a Raspberry Pi's config.txt and cmdline.txt: first pure functions on text, then the files."""

import re
from collections.abc import Callable, Iterator
from typing import Final

from gateway.files import durable
from gateway.onboard.computer import is_pi_5
from gateway.onboard.setup.machine import Machine
from gateway.people.terminal import say

_FOLDERS: Final = ("/boot/firmware", "/boot")
_SERIAL: Final = "/dev/serial0"
"""The link to the UART that Raspberry Pi OS takes for the console."""


def spi_is_on(config: str) -> bool:
    """Return whether a config.txt switches SPI on for every Pi. Lines under a filter such as [cm4] do not count."""
    lines = [line for line in _lines_of(config, r"\[all\]") if line.startswith("dtparam=")]
    stated = re.findall(r"\bspi(=\w+)?(?![\w=])", " ".join(lines))
    return bool(stated) and stated[-1] in ("", "=on", "=1", "=true", "=yes")  # the last one counts


def overlay_is_on(config: str, overlay: str) -> bool:
    """Return whether a config.txt loads this overlay on a Pi 5, with or without parameters."""
    lines = _lines_of(config, r"\[(all|pi5)\]")
    return any(re.fullmatch(rf"dtoverlay={overlay}\s*(,.*)?", line) for line in lines)


def with_line(config: str, model: str, line: str) -> str:
    """Return a config.txt with this line at its end, for one model of the Pi ("all": each).

    An empty dtoverlay= ends the overlay before it: otherwise a dtparam would count as the overlay's.
    """
    return f"{config.rstrip()}\n[{model}]\ndtoverlay=\n{line}\ndtoverlay=\n[all]\n".lstrip("\n")


def without_console(cmdline: str, names: set[str]) -> str:
    """Return a kernel command line without a console on the UARTs of these names."""
    consoles = {word for word in cmdline.split() for name in names if re.fullmatch(rf"console={name}(,.*)?", word)}
    return " ".join(word for word in cmdline.split() if word not in consoles) + "\n"


def _lines_of(config: str, filters: str) -> Iterator[str]:
    """The lines that apply under filters that match this pattern."""
    applies = True
    for line in map(str.strip, config.splitlines()):
        if line.startswith("["):
            applies = re.match(filters, line) is not None
        elif applies:
            yield line


# ---- this machine


def switch_on(machine: Machine, device: str, uart: str | None) -> None:
    """Switch SPI and the configured UART on, from the next boot if they are off."""
    _switch_on(machine, device, "all", "dtparam=spi=on", spi_is_on)
    if uart is not None:
        own = re.fullmatch(r"/dev/ttyAMA([0-4])", uart) if is_pi_5(machine.root) else None
        overlay = f"uart{own[1]}-pi5" if own else ""
        line = f"dtoverlay={overlay}" if own else ""
        _switch_on(machine, uart, "pi5", line, lambda config: overlay_is_on(config, overlay))
        _free_uart(machine, uart)


def _switch_on(machine: Machine, node: str, model: str, line: str, is_on: Callable[[str], bool]) -> None:
    """Switch the device `node` on by a line of config.txt; "": no line does on this computer."""
    config = next((f"{each}/config.txt" for each in _FOLDERS if machine.path(f"{each}/config.txt").is_file()), None)
    if machine.path(node).exists():
        say(f"{node} is there")
    elif config is None or not line:
        say(f"there is no {node}: switch it on as this computer requires")
    elif is_on(text := _text(machine, config)):
        machine.reboot_due = True
        say(f"{node} is on in {config}, but is not there: a reboot is due")
    else:
        _change(machine, config, with_line(text, model, line), f"switch {node} on ({line})")


def _free_uart(machine: Machine, uart: str) -> None:
    """End the kernel's console and the login on the controller's UART."""
    name, serial = uart.rpartition("/")[2], machine.path(_SERIAL)
    names = {name, "serial0"} if serial.is_symlink() and serial.readlink().name == name else {name}
    for cmdline in (f"{each}/cmdline.txt" for each in _FOLDERS):
        text = _text(machine, cmdline)
        if (kept := without_console(text, names)).split() != text.split():
            _change(machine, cmdline, kept, f"take the console off {uart}")
    login = f"serial-getty@{name}.service"
    if machine.is_active(login):
        machine.change(f"end the login on {uart}", lambda: machine.systemctl("disable", "--quiet", "--now", login))


def _text(machine: Machine, file: str) -> str:
    return (machine.read(file) or b"").decode(errors="surrogateescape")


def _change(machine: Machine, file: str, text: str, what: str) -> None:
    """Write the file's new text, which applies from the next boot."""

    def write() -> None:
        # The boot partition has no owners, and the file must never be half-written: write a copy, then rename it.
        path = machine.path(file)
        with durable.replacing(path, path.with_name(f"{path.name}.new")) as staged:
            staged.write_bytes(text.encode(errors="surrogateescape"))
            durable.sync(staged)

    machine.change(f"{what} in {file}: a reboot is due", write)
    machine.reboot_due = True
