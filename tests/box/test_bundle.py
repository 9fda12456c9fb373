"""A signed bundle on a machine without a network: installed, rejected in one sentence, and cut off at any moment.

One upgrade is killed in a run; HEXAPOD_KILLS=20 kills as many.
"""

import os
import random
import re
import shutil
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.box.box import SHARED_INSIDE, Box
from tests.box.bundles import Bundles
from tests.box.installed import INSTALLER, NAME
from tests.box.machine import CONFIG_TXT, STOCK, Machine

pytestmark = [pytest.mark.systemd, pytest.mark.nightly]

KILLS = int(os.environ.get("HEXAPOD_KILLS", "1"))
OPT = f"/opt/{NAME}"
UPGRADE = "upgrade"
TEMPORARY = "/var/tmp"  # noqa: S108 (the installer's own choice)
UNDER_WAY = {UPGRADE: ("active", "activating", "deactivating"), NAME: ("activating", "deactivating")}
"""What is no rest: the installer is to have ended, and the service may be on its way into the other release."""
SETTLED_S = 30.0
WHOLE = f"cd {OPT}/venv && sha256sum --check --quiet --strict complete"
OTHERS = f'for each in {OPT}/venv-*; do [ "$each" = "$(readlink -e {OPT}/venv)" ] || rm -rf "$each"; done'
OLDER, CANDIDATE, FIRST, SECOND = "1.1.9", "1.2.0rc1", "1.2.0", "1.3.0"


@pytest.fixture(scope="module")
def bundles(tmp_path_factory: pytest.TempPathFactory, wheels: Path) -> Bundles:
    return Bundles(tmp_path_factory.mktemp("bundles"), wheels)


class Robot(Machine):
    """With the first release, from a bundle, and its service on the simulated controller."""

    def __init__(self, box: Box, bundles: Bundles) -> None:
        super().__init__(box, bundles.wheels)
        self.bundles = bundles

    def bring(self, bundle: Path) -> str:
        """Where it is inside."""
        shutil.copy(bundle, self.box.shared / bundle.name)
        return f"{SHARED_INSIDE}/{bundle.name}"

    def upgrade(self, bundle: Path, *options: str, check: bool = True) -> list[str]:
        return self.run("--framing", "plain", "--force", "--bundle", self.bring(bundle), *options, check=check)

    def version(self) -> str:
        """Of what is installed."""
        return self.box.run(NAME, "--version").stdout.split()[1]

    def what_is_there(self) -> tuple[str, ...]:
        """All that an attempt might change, and the process that must go on."""
        files = self.box.run(
            "sh", "-c", f"ls --ignore='systemd-*' {OPT} {TEMPORARY}; readlink -e {OPT}/venv; cat /etc/{NAME}/*"
        ).stdout
        return files, *self.unit.properties("MainPID", "ActiveState")


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory, bundles: Bundles) -> Iterator[Robot]:
    with Box(tmp_path_factory.mktemp("robot")) as box:
        box.write(CONFIG_TXT, STOCK)
        found = Robot(box, bundles)
        said = found.upgrade(bundles.make(FIRST, "ours"))
        assert any(f"is what the key {bundles.fingerprint('ours')} has signed" in line for line in said), said
        assert any("this key is trusted from now on" in line for line in said), said
        found.simulate()
        yield found
        print(box.run("journalctl", f"--unit={NAME}", "--lines=20", "--output=cat").stdout)


def test_installed_without_a_network_by_the_installer_of_the_release(robot: Robot) -> None:
    assert robot.version() == FIRST
    robot.box.run("sh", "-c", WHOLE)
    assert robot.unit.property("ActiveState") == "active"
    repeat = robot.box.read(f"{OPT}/venv/again")  # which `check` prints where a file is damaged
    assert re.fullmatch(rf"bash {OPT}/\S+/gateway/deploy/install\.sh --bundle /\S+\n", repeat)
    assert robot.box.read(f"/etc/{NAME}/release.pub").startswith("ssh-ed25519 ")
    assert robot.box.run("sh", "-c", f"ls -d {TEMPORARY}/{NAME}.* 2>/dev/null", check=False).stdout == ""
    again = robot.upgrade(robot.bundles.make(FIRST, "ours"))
    assert any(line.startswith("keep ") and "every file as installed" in line for line in again), again
    assert not any("trusted from now on" in line for line in again)


def changed_wheel(members: dict[str, bytes]) -> None:
    name = next(name for name in members if name.startswith("pydantic-"))
    members[name] = members[name][:-1] + bytes([members[name][-1] ^ 1])


def without_signature(members: dict[str, bytes]) -> None:
    del members["SHA256SUMS.sig"]


def other_sums(members: dict[str, bytes]) -> None:
    members["SHA256SUMS"] += b"0" * 64 + b"  more\n"


def one_more(members: dict[str, bytes]) -> None:
    members["evil.whl"] = b""


def test_each_is_rejected_in_one_sentence_and_the_service_goes_on(robot: Robot) -> None:
    bundles = robot.bundles
    second = bundles.make(SECOND, "ours")
    cut = bundles.folder / "cut"
    cut.write_bytes(second.read_bytes()[:1_000_000])
    theirs = bundles.fingerprint("theirs")
    cases = [
        (bundles.changed(second, "changed", changed_wheel), "is not what was released: it was changed"),
        (bundles.changed(second, "unsigned", without_signature), "is not signed"),
        (bundles.changed(second, "sums", other_sums), "is not of its sums: it was changed"),
        (bundles.changed(second, "more", one_more), "has other files than its sums name"),
        (bundles.make(SECOND, "theirs"), f"is signed by another key ({theirs}) than this robot trusts ("),
        (bundles.make(OLDER, "ours"), f"has release {OLDER}, and {FIRST} is installed, which is newer"),
        (bundles.make(CANDIDATE, "ours"), f"has release {CANDIDATE}, and {FIRST} is installed, which is newer"),
        (cut, "is no bundle of `make dist`, or was cut off"),
    ]
    before = robot.what_is_there()
    for bundle, sentence in cases:
        said = robot.upgrade(bundle, check=False)
        assert len(said) == 1, said
        assert said[0].startswith("install.sh: "), said
        assert sentence in said[0]
        assert robot.what_is_there() == before, sentence
    wrong = robot.upgrade(second, "--trust", theirs, check=False)
    assert (len(wrong), "and --trust names" in wrong[0]) == (1, True)
    assert robot.what_is_there() == before
    for bundle, option in ((cases[4][0], ("--trust", theirs)), (cases[5][0], ("--allow-downgrade",))):
        said = robot.upgrade(bundle, "--dry-run", *option)
        assert any("is what the key" in line for line in said), said
    assert robot.what_is_there() == before


def test_a_full_disk_and_what_is_no_python_are_sentences_and_killed_installers_leave_nothing(robot: Robot) -> None:
    box, second = robot.box, robot.bundles.make(SECOND, "ours")
    (said,) = robot.run("--bundle", robot.bring(second), check=False, python="/bin/true")
    assert said.startswith("install.sh: /bin/true is no Python")
    # Of an installer that was killed, with a number that no process has; of one that runs; of another user.
    gone, runs, theirs = (f"{TEMPORARY}/{NAME}.{name}" for name in ("4194304.aaaaaa", "1.bbbbbb", "4194304.cccccc"))
    box.run("mkdir", gone, runs, theirs)
    box.run("chown", "nobody", theirs)
    before = robot.what_is_there()
    box.run("mount", "-t", "tmpfs", "-o", "size=1m", "tmpfs", TEMPORARY)
    (said,) = robot.upgrade(second, check=False)
    box.run("umount", TEMPORARY)
    assert said.startswith(f"install.sh: {TEMPORARY} has no room for /box-out/"), said
    assert robot.what_is_there() == before
    robot.upgrade(robot.bundles.make(OLDER, "ours"), check=False)
    assert [box.exists(path) for path in (gone, runs, theirs)] == [False, True, True]
    box.run("rmdir", runs, theirs)


def test_killed_at_any_moment_it_leaves_one_whole_release(robot: Robot) -> None:
    box, moments = robot.box, random.SystemRandom()
    bring = {version: robot.bring(robot.bundles.make(version, "ours")) for version in (FIRST, SECOND)}
    began_s = time.monotonic()
    robot.upgrade(robot.bundles.make(SECOND, "ours"))
    lasts_s = time.monotonic() - began_s
    seen: list[str] = []
    for kill in range(KILLS):
        present = robot.version()
        target = FIRST if present == SECOND else SECOND
        box.run("sh", "-c", OTHERS)
        options = ("--framing", "plain", "--force", "--allow-downgrade", "--bundle", bring[target])
        box.run("systemd-run", "--quiet", "--collect", f"--unit={UPGRADE}", INSTALLER, *options)
        after_s = moments.uniform(0, lasts_s)
        time.sleep(after_s)  # a moment, and not a wait for anything
        box.run("systemctl", "kill", "--signal=KILL", UPGRADE, check=False)
        deadline_s = time.monotonic() + SETTLED_S
        for unit, under_way in UNDER_WAY.items():
            while box.run("systemctl", "is-active", unit, check=False).stdout.strip() in under_way:
                assert time.monotonic() < deadline_s, f"{unit} does not come to rest"
                time.sleep(0.05)
        found = robot.version()
        seen.append(f"kill {kill + 1} after {after_s:.1f} s of {lasts_s:.1f}: {found}")
        assert found in (present, target), seen
        box.run("sh", "-c", WHOLE)
        assert robot.unit.property("ActiveState") == "active", seen
        box.run("systemctl", "restart", NAME)
        assert "accepted" in robot.send(), seen
    print("\n".join(seen))
    said = robot.upgrade(robot.bundles.make(SECOND, "ours"))
    assert robot.version() == SECOND, said
    assert box.run("sh", "-c", f"ls -d {OPT}/venv-*").stdout.count("\n") <= 2
