"""The locks by which a gateway learns of `stop-servos`, between processes; and what the gateway then says."""

import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from gateway.robot.spi import outside
from gateway.robot.spi.outside import Listener, Notice


@pytest.fixture
def device(tmp_path: Path) -> Path:
    """Return a file in place of the device: locks are the same on both."""
    path = tmp_path / "device"
    path.touch()
    return path


def opened(device: Path) -> int:
    return os.open(device, os.O_RDWR)


def test_a_gateway_sees_it_at_work_and_it_stays_until_the_gateway_knows_of_its_end(device: Path) -> None:
    gateway = Listener(opened(device))
    assert not gateway.poll()
    notice = Notice(str(device))
    notice.give()
    assert notice.gateway_runs
    ended: list[bool] = []
    end = threading.Thread(target=lambda: ended.append(notice.end()))
    end.start()
    assert gateway.poll(), "it has not left, since nobody had looked"
    while gateway.poll():
        pass
    end.join()
    assert ended == [True]
    assert not gateway.poll()


def test_without_a_gateway_nothing_is_waited_for(device: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(outside, "PATIENCE_S", 3600)
    notice = Notice(str(device))
    notice.give()
    assert not notice.gateway_runs
    assert notice.end()


def test_two_of_them_are_seen_until_the_second_has_ended(device: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(outside, "PATIENCE_S", 0.01)
    gateway = Listener(opened(device))
    first, second = Notice(str(device)), Notice(str(device))
    first.give()
    second.give()
    assert gateway.poll()
    assert first.end()
    assert gateway.poll()
    assert second.end()
    assert not gateway.poll()


def test_the_death_of_a_program_ends_its_notice(device: Path) -> None:
    gateway = Listener(opened(device))
    program = (
        "import sys, time\nfrom gateway.robot.spi.outside import Notice\n"
        "notice = Notice(sys.argv[1])\nnotice.give()\nprint('at work', flush=True)\ntime.sleep(60)\n"
    )
    with subprocess.Popen([sys.executable, "-c", program, str(device)], stdout=subprocess.PIPE) as child:
        assert child.stdout is not None
        child.stdout.readline()
        assert gateway.poll()
        child.kill()
    assert not gateway.poll()


def test_what_a_vanished_device_does_not_say_is_not_known(device: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fd = opened(device)
    gateway = Listener(fd)
    os.close(fd)
    assert gateway.poll() is None
    monkeypatch.setattr(outside, "PATIENCE_S", 0.01)
    notice = Notice(str(device))
    notice.give()
    assert notice._fd is not None
    os.close(notice._fd)
    notice._fd = os.open(device, os.O_PATH)  # takes no locks
    assert not notice.end(), "nobody is known to have seen it"
