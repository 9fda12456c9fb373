"""From the release before this one, to it, back and to it again: whatever runs, and wherever the way is cut.

An upgrade is killed at two of its changes, and the plug is pulled at two; HEXAPOD_KILLS=10: at ten.
"""

import os
import select
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.box.box import PATH_INSIDE, Box
from tests.box.disk import Disk
from tests.box.last_release import Upgrade
from tests.box.test_installer import SERVO_RUNS
from tests.box.test_power_cut import folder
from tests.support.child import Child

pytestmark = [pytest.mark.systemd, pytest.mark.nightly]

LIFE_S = 2400  # on a busy machine each of the scenes takes a minute


@pytest.fixture(scope="module")
def upgraded(tmp_path_factory: pytest.TempPathFactory, wheels: Path, last_layer: Path) -> Iterator[Upgrade]:
    """One robot for all tests of this file."""
    with Box(tmp_path_factory.mktemp("upgraded"), base=last_layer, life_s=LIFE_S) as box:
        yield Upgrade(box, wheels)


@pytest.fixture
def robot(upgraded: Upgrade) -> Upgrade:
    upgraded.begin()
    return upgraded


@pytest.fixture(scope="module")
def points(upgraded: Upgrade) -> list[int]:
    """Some of the changes that an upgrade makes."""
    return upgraded.points()


@pytest.mark.parametrize("service", ["off", "idle", "moving"])
def test_forward_back_and_forward(robot: Upgrade, service: str) -> None:
    """Nobody has to add --force; while a servo runs, nothing is changed, whichever of the two releases holds it."""
    for step in (robot.forward, robot.back, robot.forward):
        before = robot.venv()
        if service == "off":
            robot.unit.systemctl("stop")
        if service == "moving":
            held, process = robot.hold(), robot.unit.property("MainPID")
            assert step(check=False)[-1] == SERVO_RUNS
            assert (robot.venv(), robot.runs(), robot.unit.property("MainPID")) == (before, before, process)
            robot.let_go(held)
        step()
        assert robot.venv() != before
        robot.unit.systemctl("start")
        robot.is_at_work()


def test_the_plug_is_pulled(tmp_path: Path, wheels: Path, last_layer: Path) -> None:
    """One of both releases comes up from each disk, and the installer finishes, and asks for nothing."""
    disk, cuts = Disk.new(tmp_path / "disk"), []
    with Box(folder(tmp_path, "first"), disk=disk.image, base=last_layer) as box:
        robot = Upgrade(box, wheels)
        points = robot.points()
        box.run("sync")
        for name in ("point", "go"):
            os.mkfifo(box.shared / name)
        point, go = (os.open(box.shared / name, os.O_RDWR) for name in ("point", "go"))
        command = box.command(*robot.counted(wait=points))
        with Child(command, {"PATH": PATH_INSIDE, "LANG": "C.UTF-8"}) as upgrade:
            for place in points:
                assert select.select([point], [], [], 120)[0], upgrade.stdout
                assert int(os.read(point, 20)) == place
                cuts.append(disk.cut(tmp_path / f"cut-{place}"))
                os.write(go, b"\n")
            assert upgrade.wait(120) == 0
        this = robot.venv()
    for cut in cuts:
        with Box(folder(tmp_path, f"after-{cut.image.name}"), disk=cut.image) as box:
            robot = Upgrade(box, wheels)
            robot.is_at_work()
            robot.forward()
            assert robot.venv() == this
            robot.is_at_work()
        cut.image.unlink()
