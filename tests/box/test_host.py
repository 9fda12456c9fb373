"""A box leaves the machine around it as it was: kernel settings, binary formats, mounts, cgroups and devices."""

import os
import socket
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import pytest

from tests.box.box import Box
from tests.support.child import Child

pytestmark = [pytest.mark.systemd, pytest.mark.alone]
"""Other boxes would show."""

SETTINGS = Path("/proc/sys")
COUNTERS = (
    "fs/aio-nr",
    "fs/binfmt_misc",  # of its own below; a look at it may mount it
    "fs/dentry-state",
    "fs/file-nr",
    "fs/inode-nr",
    "fs/inode-state",
    "fs/quota",
    "kernel/ns_last_pid",
    "kernel/perf_event_max_sample_rate",  # the kernel lowers it on a busy machine
    "kernel/pty/nr",
    "kernel/random",
    "vm/min_free_kbytes",
)
"""What changes by itself, or counts."""
OF_OTHERS = "/run/"
"""Services, logins and other tests mount below it at any time."""
NEEDED = {"overlay"}
"""Modules that a box cannot do without."""
FORMAT = "hexapod-box"
FORMATS = """
set -e
mount -t binfmt_misc binfmt_misc "$1"
trap '[ ! -e "$1/$2" ] || echo -1 >"$1/$2"' EXIT
echo ":$2:E::$2::/bin/true:" >"$1/register"
echo ready
while read -r word && [ "$word" = list ]; do echo $(ls "$1"); done
"""
"""Registers a format of the test's own in a mount that nobody else sees, and lists all as often as it is asked."""


@dataclass(frozen=True)
class Machine:
    """What of a machine a second systemd might change."""

    formats: tuple[str, ...]
    settings: dict[str, str]
    modules: frozenset[str]
    mounts: tuple[str, ...]
    cgroups: tuple[str, ...]
    devices: tuple[str, ...]
    hostname: str

    @classmethod
    def seen(cls, formats: Child) -> "Machine":
        """As it is now."""
        mounts = [line.split(" ") for line in Path("/proc/self/mountinfo").read_text().splitlines()]
        hierarchies = [Path(each[4]) for each in mounts if each[each.index("-") + 1].startswith("cgroup")]
        modules = Path("/proc/modules")
        return cls(
            tuple(formats.ask("list").split()),
            {str(name): value for name in settings() if (value := text(SETTINGS / name)) is not None},
            frozenset(line.split(" ")[0] for line in modules.read_text().splitlines())
            if modules.exists()
            else frozenset(),
            tuple(" ".join(each[3:6]) for each in mounts if not each[4].startswith(OF_OTHERS)),
            tuple(f"{path}: {text(path / 'cgroup.subtree_control')} {below(path)}" for path in hierarchies),
            tuple(sorted(os.listdir("/dev"))),
            socket.gethostname(),
        )


def settings() -> Iterator[Path]:
    for folder in ("fs", "kernel", "vm"):
        for parent, _, files in os.walk(SETTINGS / folder):
            names = (Path(parent, file).relative_to(SETTINGS) for file in files)
            yield from (name for name in names if not any(name.is_relative_to(each) for each in COUNTERS))


def text(path: Path) -> str | None:
    """Some settings can only be written."""
    try:
        return path.read_text(errors="replace")
    except OSError:
        return None


def below(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir() if path.is_dir())


@pytest.fixture
def formats(tmp_path: Path) -> Iterator[Child]:
    """The kernel's registrations in binfmt_misc, one of them the test's own."""
    place = tmp_path / "formats"
    place.mkdir()
    with Child(["unshare", "--mount", "bash", "-c", FORMATS, "formats", str(place), FORMAT], os.environ) as child:
        child.wait_for_output("ready")
        yield child
        child.tell("end")
        assert child.wait() == 0


def test_a_box_leaves_the_machine_as_it_was(formats: Child, tmp_path: Path) -> None:
    before = Machine.seen(formats)
    assert FORMAT in before.formats
    with Box(tmp_path) as box:
        assert box.run("systemctl", "is-active", "basic.target").stdout == "active\n"
    after = Machine.seen(formats)
    assert after.modules - before.modules <= NEEDED
    was = asdict(before)
    changed = {name: (was[name], value) for name, value in asdict(after).items() if value != was[name]}
    changed.pop("modules", None)
    if values := changed.pop("settings", None):
        changed |= {name: (values[0].get(name), now) for name, now in values[1].items() if now != values[0].get(name)}
    assert changed == {}
