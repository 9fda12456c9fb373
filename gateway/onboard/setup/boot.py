"""SPI and UARTs in a Raspberry Pi's config.txt and cmdline.txt: first pure functions on text, then the files."""

import re
from collections.abc import Callable, Iterator
from typing import Final

from gateway import durable
from gateway.errors import ConfigError
from gateway.onboard.setup.machine import Machine
from gateway.people.terminal import say

_FOLDERS: Final = ("/boot/firmware", "/boot")
_SPI: Final = re.compile(r"\s*#?\s*dtparam=spi(=on|=off)?\s*")
_PI_5: Final = re.compile(r"Raspberry Pi (5|Compute Module 5)")
_SERIAL: Final = "/dev/serial0"
"""The link to the UART that Raspberry Pi OS takes for the console."""


def spi_is_on(config: str) -> bool:
    """Return whether a config.txt switches SPI on for every Pi. Lines under a filter such as [cm4] do not count."""
    on = False
    for line in _lines_of(config, r"\[all\]"):
        for parameter in line.removeprefix("dtparam=").split(",") if line.startswith("dtparam=") else ():
            if re.fullmatch(r"spi(=on|=1|=true|=yes)?\s*", parameter):
                on = True
            elif parameter.startswith("spi="):
                on = False
    return on


def with_spi(config: str) -> str:
    """Return a config.txt with SPI on: in its dtparam=spi line, or in a new first line before filters and overlays."""
    lines, filtered, found = config.splitlines(), False, False
    for at, line in enumerate(lines):
        if line.lstrip().startswith("["):
            filtered = "[all]" not in line
        elif not filtered and _SPI.fullmatch(line):
            lines[at], found = "dtparam=spi=on", True
    return "\n".join([*([] if found else ["dtparam=spi=on"]), *lines, ""])


def overlay_is_on(config: str, overlay: str) -> bool:
    """Return whether a config.txt loads this overlay on a Pi 5, with or without parameters."""
    lines = _lines_of(config, r"\[(all|pi5)\]")
    return any(re.fullmatch(rf"dtoverlay={overlay}\s*(,.*)?", line) for line in lines)


def with_overlay(config: str, overlay: str) -> str:
    """Return a config.txt with this overlay at its end, for a Pi 5 only.

    The empty dtoverlay= ends the overlay: otherwise a later dtparam would count as the overlay's.
    """
    return f"{config.rstrip()}\n[pi5]\ndtoverlay={overlay}\ndtoverlay=\n[all]\n".lstrip("\n")


def without_console(cmdline: str, names: set[str]) -> str:
    """Return a kernel command line without a console on the UARTs of these names."""
    kept = (word for word in cmdline.split() if not _is_console(word, names))
    return " ".join(kept) + "\n"


def _is_console(word: str, names: set[str]) -> bool:
    return word.startswith("console=") and word.removeprefix("console=").split(",")[0] in names


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
    """Switch SPI and the configured UART on, from the next boot if they are off. Raises ConfigError."""
    config = next((f"{each}/config.txt" for each in _FOLDERS if machine.path(f"{each}/config.txt").is_file()), None)
    text = _text(machine, config) if config else ""
    if machine.path(device).exists():
        say(f"{device} is there")
    elif config is None:
        say(
            f"there is no {device}, and no config.txt: this is no Raspberry Pi, so switch SPI on as this board requires"
        )
    elif spi_is_on(text):
        machine.reboot_due = True
        say(f"SPI is on in {config}, but {device} is not there: a reboot is due")
    elif not spi_is_on(with_spi(text)):
        raise ConfigError(f"SPI is off in {config} in a way that a person must change: it needs dtparam=spi=on")
    else:
        text = _change(machine, config, text, with_spi, "switch SPI on (dtparam=spi=on)")
    if uart is not None:
        _switch_uart_on(machine, uart, config, text)
        _free_uart(machine, uart)


def _switch_uart_on(machine: Machine, uart: str, config: str | None, text: str) -> None:
    model = machine.path("/proc/device-tree/model")
    on_pi_5 = model.is_file() and _PI_5.match(model.read_text().strip("\0"))
    own = re.fullmatch(r"/dev/ttyAMA([0-4])", uart)
    if machine.path(uart).exists():
        say(f"{uart} is there")
    elif config is None or own is None or not on_pi_5:
        say(f"there is no {uart}: switch this UART on as this computer requires")
    elif overlay_is_on(text, overlay := f"uart{own[1]}-pi5"):
        machine.reboot_due = True
        say(f"{uart} is on in {config}, but is not there: a reboot is due")
    else:
        _change(
            machine, config, text, lambda old: with_overlay(old, overlay), f"switch {uart} on (dtoverlay={overlay})"
        )


def _free_uart(machine: Machine, uart: str) -> None:
    """End the kernel's console and the login on the controller's UART."""
    name, serial = uart.rpartition("/")[2], machine.path(_SERIAL)
    names = {name, "serial0"} if serial.is_symlink() and serial.readlink().name == name else {name}
    for cmdline in (f"{each}/cmdline.txt" for each in _FOLDERS if machine.path(f"{each}/cmdline.txt").is_file()):
        text = _text(machine, cmdline)
        if any(_is_console(word, names) for word in text.split()):
            _change(machine, cmdline, text, lambda old: without_console(old, names), f"take the console off {uart}")
            break
    login = f"serial-getty@{name}.service"
    if machine.is_active(login):
        machine.change(f"end the login on {uart}", lambda: machine.systemctl("disable", "--quiet", "--now", login))


def _text(machine: Machine, file: str) -> str:
    return (machine.read(file) or b"").decode(errors="surrogateescape")


def _change(machine: Machine, file: str, text: str, edit: Callable[[str], str], what: str) -> str:
    """Write the edited file, which applies from the next boot. Return the new text."""
    new = edit(text)

    def write() -> None:
        # The boot partition has no owners, and the file must never be half-written: write a copy, then rename it.
        path = machine.path(file)
        staged = path.with_name(f"{path.name}.new")
        staged.write_bytes(new.encode(errors="surrogateescape"))
        durable.sync(staged)
        staged.replace(path)
        durable.sync(path.parent)

    machine.change(f"{what} in {file}: a reboot is due", write)
    machine.reboot_due = True
    return new
