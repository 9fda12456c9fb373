"""The installed package on a machine of its own, as a person has it: README's commands, and the ends of a service.

Played in this order: each scene begins where the one before has ended. What is judged is which frames come first, and
from which process.
"""

import platform
import shlex
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from tests.kernel.inside import wire
from tests.support.waiting import wait_until

NAME: Final = "hexapod-gateway"
LIBRARY: Final = f"/usr/lib/{NAME}"
WITHIN_S: Final = 600.0
SLOW: Final = "[Service]\nTimeoutStartSec=600\nTimeoutStopSec=300\nTimeoutAbortSec=60\nWatchdogSec=30\n"
"""For an emulated processor beside other programs."""
FIRST_CONTACT: Final = "61\n90\nyes\nyes\nyes\n"
"""Which servo, from where, to move it, it moved, it is loose."""


def run(*command: str, code: int = 0) -> str:
    """What it printed. Its exit code has to be this one."""
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=WITHIN_S)
    said = (done.stdout + done.stderr).strip()
    assert done.returncode == code, f"{shlex.join(command)} ended with {done.returncode}: {said[-600:]}"
    return said


def gateway(command: str, *, code: int = 0) -> str:
    return run(NAME, *command.split(), code=code)


def starts() -> None:
    wire.forget()
    gateway("send leg 3 start 90 45 120 --timeout 60")
    assert any(each[2] == 31 and each[3] != 2 for each in frames()), "no frame starts leg 3"


def starts_nothing() -> None:
    assert "estop" in gateway("send leg 3 start 90 45 120 --timeout 60", code=1)
    assert "nothing runs until a reset" in gateway("status --timeout 60")


def shown(name: str) -> str:
    return run("systemctl", "show", f"--property={name}", "--value", NAME)


def process() -> int:
    return int(shown("MainPID"))


def frames(but: int = 0) -> list[bytes]:
    """Frames since `wire.forget`, without those of this process."""
    found = (each for each in wire.records() if each.kind == wire.BEGIN and each.process != but)
    return [each.data[: each.size] for each in found if each.size > 1]


def until_active() -> None:
    wait_until(lambda: shown("ActiveState") == "active", "the service is active", WITHIN_S)


@contextmanager
def stops_first(what: str) -> Iterator[int]:
    """Within, the service's process comes to its end. Then other processes' first frames are six Stops."""
    before = process()
    wire.forget()
    yield before
    wait_until(lambda: len(frames(before)) >= len(wire.STOPS), f"Stops after {what}", WITHIN_S)
    assert set(frames(before)[: len(wire.STOPS)]) == set(wire.STOPS), f"other frames came first after {what}"


def installed() -> str:
    assert platform.machine() == "aarch64"
    assert (shown("ActiveState"), shown("UnitFileState")) == ("inactive", "disabled")
    return f"{gateway('--version')}; the service is neither started nor enabled"


def set_up() -> str:
    drop_in = Path(f"/etc/systemd/system/{NAME}.service.d/slow.conf")
    drop_in.parent.mkdir(parents=True)
    drop_in.write_text(SLOW)
    said = gateway("setup --framing length-prefixed")
    until_active()
    sent = frames()
    assert set(sent[:6]) == set(wire.STOPS), "its first frames are not six Stops"
    return said.splitlines()[-1]


def checked() -> str:
    said = gateway("check")
    assert "not as installed" not in said
    return said.splitlines()[-1]


def first_contact() -> str:
    command = shlex.quote(f"{NAME} check --move --timeout 60")
    typed = f"printf %s {shlex.quote(FIRST_CONTACT)} | script -qefc {command} /dev/null"
    said = run("sh", "-c", typed)
    assert "Then everything from here to servo 61 works." in said, said[-600:]
    return "servo 61 moved, and was stopped"


def proven() -> str:
    said = gateway("check --stops --yes --timeout 60 --late 5000")
    assert said.count("PASS") >= 4, said
    return f"{said.count('PASS')} steps pass"


def killed() -> str:
    """An emergency stop, then SIGKILL: it is kept."""
    starts()
    wire.forget()
    gateway("estop --timeout 60")
    assert set(wire.STOPS) <= set(frames()), "an emergency stop is six Stops"
    starts_nothing()
    with stops_first("SIGKILL") as before:
        run("kill", "-KILL", str(before))
    wait_until(lambda: process() not in (0, before), "another process", WITHIN_S)
    until_active()
    starts_nothing()
    gateway("reset --timeout 60")
    starts()
    return "six Stops by another process first; the emergency stop was kept, and a reset ends it"


def hung() -> str:
    """SIGSTOP: systemd's watchdog ends it."""
    starts()
    with stops_first("SIGSTOP") as before:
        run("kill", "-STOP", str(before))
    wait_until(lambda: process() not in (0, before), "another process", WITHIN_S)
    until_active()
    starts()
    return "systemd ends it; six Stops by another process first; it starts again"


def upgraded() -> str:
    """Upgrade and back; an emergency stop stays."""
    gateway("estop --timeout 60")
    for release in ("1.1.1", "1.1.0"):
        (package,) = Path("build/kernel/arm64/packages").glob(f"{release}/*.deb")
        with stops_first("an upgrade"):
            run("dpkg", "--install", str(package))
        until_active()
        assert f"{LIBRARY}/{release}/" in Path(f"/proc/{process()}/maps").read_text()
        starts_nothing()
    gateway("reset --timeout 60")
    starts()
    return "1.1.1 and back: six Stops by another process first, and the emergency stop was kept each time"


def ended() -> str:
    starts()
    with stops_first("systemctl stop"):
        run("systemctl", "stop", NAME)
    assert shown("Result") == "success"
    return "six Stops, and systemd calls its end a success"


def removed() -> str:
    run("dpkg", "--purge", NAME)
    left = [
        place for place in (f"/etc/{NAME}", f"/var/lib/{NAME}", LIBRARY, f"/usr/bin/{NAME}") if Path(place).exists()
    ]
    assert not left, f"left: {left}"
    return "nothing is left"
