"""An emergency stop outlasts the gateway, and a gateway learns of `stop-servos` by locks: with real processes."""

import json
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from gateway.client import Client
from gateway.files import durable
from gateway.robot.runtime.estop_keeper import ESTOP_FILE, LAST_FILE, SLOW_S, KeptEstop, read
from gateway.robot.spi import outside
from gateway.robot.spi.outside import Listener, Notice
from schemas import keys
from schemas.words import Kind, Mode, Reason
from tests.support.gateway_process import Gateway
from tests.support.heard import events
from tests.support.waiting import wait_until

LATE_S = 15.0
TRIALS = int(os.environ.get("TRIALS", "3"))


def start(folder: Path) -> Gateway:
    return Gateway(folder, {"state": {"path": str(folder / "state")}})


def press(client: Client, source: str = "anna") -> int:
    ack = client.ask(keys.ESTOP, {"source": source})
    assert ack.stop_frames == 6
    assert ack.estop is not None
    return ack.estop


def is_kept(folder: Path, number: int) -> bool:
    path = folder / ESTOP_FILE
    text = path.read_text() if path.exists() else ""  # it is there before its text is
    return bool(text) and json.loads(text)["number"] == number


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGTERM])
def test_an_emergency_stop_outlasts_a_gateway_until_a_reset(tmp_path: Path, how: signal.Signals) -> None:
    state = tmp_path / "state"
    with start(tmp_path) as first, first.client() as client:
        assert press(client, "anna") == 1
        since = client.state().estop_since
        if how is signal.SIGKILL:  # an end in order waits for the write
            wait_until(lambda: is_kept(state, 1))
        first.child.send_signal(how)
        first.child.wait(LATE_S)
    assert is_kept(state, 1)
    with start(tmp_path) as second, second.client() as client:
        found = client.state()
        assert (found.mode, found.estop) == (Mode.ESTOPPED, 1)
        assert (found.estop_source, found.estop_since, found.estop_fault) == ("anna", since, None)
        assert client.start_leg(3, 90, 90, 90, check=False).reason is Reason.ESTOPPED
        second.child.wait_for_output("is still engaged")
        assert client.ask(keys.RESET, {"estop": 1}).accepted
        wait_until(lambda: not (state / ESTOP_FILE).exists())
        second.child.kill()
    with start(tmp_path) as third, third.client() as client:
        found = client.state()
        assert (found.mode, found.estop, found.estop_since) == (Mode.IDLE, 1, None)
        assert press(client) == 2
        assert client.ask(keys.RESET, {"estop": 1}).reason is Reason.ESTOPPED, "it was sent to an earlier run"


@pytest.mark.parametrize("reset_before", [False, True])
def test_what_the_answer_states_to_be_kept_outlasts_a_kill_at_the_answer(tmp_path: Path, reset_before: bool) -> None:
    lost, kept = list[tuple[bool, KeptEstop]](), 0
    for trial in range(TRIALS):
        folder = tmp_path / str(trial)
        folder.mkdir()
        with start(folder) as gateway, gateway.client() as client:
            if reset_before:
                assert client.ask(keys.RESET, {"estop": press(client)}).accepted
            ack = client.ask(keys.ESTOP, {})
            gateway.child.kill()
            gateway.child.wait(LATE_S)
        found = read(folder / "state")
        assert ack.kept is not None
        kept += ack.kept
        if (found.engaged, found.number) != (True, ack.estop):
            lost.append((ack.kept, found))
    print(f"{TRIALS} kills at the answer: {kept} kept, {len(lost)} lost or older")
    assert not [each for each in lost if each[0]]
    assert kept, "a disk that works keeps them in time"


# ---- the disk (all ways to be damaged: tests/unit/robot/test_estop_file.py)


def test_where_the_disk_hangs_it_starts_estopped_says_so_and_a_person_may_reset_it(tmp_path: Path) -> None:
    (tmp_path / "state").mkdir()
    os.mkfifo(durable.staged_for(tmp_path / "state" / LAST_FILE))
    with start(tmp_path) as first, first.client() as client:
        found = client.state()
        assert found.mode is Mode.ESTOPPED
        assert "has not answered for 2 s" in str(found.estop_fault)
        assert found.spi.frames >= 6, "no Stop waits for it"
        first.child.wait_for_output("since it is not known what an earlier run has left")
        assert client.start_leg(3, 90, 90, 90, check=False).reason is Reason.ESTOPPED
        assert client.ask(keys.RESET, {"estop": found.estop}).accepted
        assert client.start_leg(3, 90, 90, 90).accepted


def test_no_stop_waits_for_a_disk_that_hangs_while_it_runs(tmp_path: Path) -> None:
    with start(tmp_path) as first, first.client() as client:
        os.mkfifo(durable.staged_for(tmp_path / "state" / ESTOP_FILE))
        heard = events(client)
        for number in (1, 2, 3):
            assert press(client) == number
        assert client.state().mode is Mode.ESTOPPED
        event = heard.wait(lambda each: each.kind == Kind.ESTOP_NOT_KEPT, timeout_s=SLOW_S + LATE_S)
        assert "has not answered for 5 s" in event.detail
        assert client.ask(keys.RESET, {"estop": 3}).accepted
        first.child.send_signal(signal.SIGTERM)
        assert first.child.wait(LATE_S) == 0, "the disk hangs on"


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
