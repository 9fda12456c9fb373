"""`hexapod-gateway setup`: set up an installed package on this robot. It prints each change as a sentence.

It changes only what differs, so it can run again at any time.
"""

import os
import subprocess
from functools import partial
from pathlib import Path
from typing import NamedTuple

from gateway.errors import GatewayError
from gateway.onboard import release_switch
from gateway.onboard.setup import boot, certificates, configuration, service
from gateway.onboard.setup.machine import ETC, SERVICE, Machine
from gateway.people.terminal import say


class Wanted(NamedTuple):
    """The command's options."""

    wire: str | None = None
    framing: str | None = None
    certs: Path | None = None
    console: bool = False
    back: bool = False


def setup(machine: Machine, wanted: Wanted) -> int:
    """Set this machine up, and run `check`. Return the exit code. Raises GatewayError with one sentence."""
    try:
        if wanted.back:
            current, release = release_switch.other()
            to = release.name.removesuffix(".kept")
            machine.change(f"go from {current} to {to}, and restart the service", partial(_go_back, release))
        else:
            _set_up(machine, wanted)
    except (OSError, subprocess.SubprocessError) as error:
        what = f"{error.filename or 'setup'}: {error.strerror or error}" if isinstance(error, OSError) else str(error)
        raise GatewayError(f"{what}; nothing after that was done") from error
    if machine.dry:
        say("Nothing was changed. Without --dry-run, `check` follows.")
    elif machine.reboot_due:
        say("Next: sudo reboot; then: sudo hexapod-gateway check")
    else:
        return machine.check()
    return 0


def _set_up(machine: Machine, wanted: Wanted) -> None:
    service.remove_former(machine)
    stated = configuration.state_wire(machine, wanted.wire, wanted.framing)
    if wanted.certs is not None:
        stated = certificates.take(machine, wanted.certs, stated)
    certificates.refresh(machine)
    if machine.let_read(ETC, SERVICE):
        machine.restart_due = True
    device = stated.get("spi", "device", "/dev/spidev0.0")
    boot.switch_on(machine, device, stated.uart)
    if not machine.dry:
        os.sync()  # before the restart: a power cut must not leave other files than those that run
    service.start(machine, device)
    if wanted.console or machine.show(f"{service.CONSOLE}.socket", "UnitFileState") == "enabled":
        service.start_console(machine)


def _go_back(release: Path) -> None:
    if said := release_switch.go_back(release):
        say(said)
