"""A fork of tests/support/zygote.py is to the tests what a process of its own is: both ways, with the same result."""

import os
import signal
import sys
from pathlib import Path

import pytest

from tests.support import zygote
from tests.support.child import Child
from tests.support.gateway_process import COMMAND

HERE = "tests.zenoh.test_fork_server"


def main() -> None:
    """What a child says of itself."""
    number = int(sys.argv[1])
    print(os.environ["SAYS"], Path.cwd().name, os.read(number, 5).decode(), sys.stdin.readline().strip())
    print(
        "files",
        *sorted(int(each) for each in os.listdir("/proc/self/fd") if Path(f"/proc/self/fd/{each}").exists()),
        flush=True,
    )
    print("at once", file=sys.stderr)
    sys.stdin.readline()
    sys.exit(7)


@pytest.fixture(params=["yes", "no"])
def forked(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> bool:
    monkeypatch.setenv("ZYGOTE", request.param)
    return bool(request.param == "yes")


def test_it_has_what_it_was_given_and_nothing_else(forked: bool, tmp_path: Path) -> None:
    read, write = os.pipe()
    os.write(write, b"piped")
    (tmp_path / "tests").symlink_to(Path(__file__).parents[1])
    with Child([sys.executable, "-m", HERE, str(read)], {**os.environ, "SAYS": "this"}, tmp_path, [read]) as child:
        assert isinstance(child._popen, zygote.Forked) is forked
        assert child.ask("asked") == f"this {tmp_path.name} piped asked\n"
        assert child.wait_for_line(1) == f"files 0 1 2 {read}\n"
        child.wait_for_output("at once")  # while it runs, for it is a line of its standard error
        assert child.returncode is None
        child.tell("end")
        assert child.wait() == 7
    os.close(read)
    os.close(write)


def test_a_signal_is_its_exit_status(forked: bool) -> None:
    with Child([*COMMAND, "run", "--sim"], {**os.environ, "HEXAPOD_ZENOH__LISTEN": '["tcp/127.0.0.1:0"]'}) as child:
        assert isinstance(child._popen, zygote.Forked) is forked
        child.wait_for_output("ready")
        with pytest.raises(TimeoutError):
            child.wait(0.01)
        child.send_signal(signal.SIGINT)
        assert child.wait() == 0
    with Child([*COMMAND, "run", "--sim"], {**os.environ, "HEXAPOD_ZENOH__LISTEN": '["tcp/127.0.0.1:0"]'}) as child:
        child.kill()
        assert child.returncode == -signal.SIGKILL


if __name__ == "__main__":
    main()
