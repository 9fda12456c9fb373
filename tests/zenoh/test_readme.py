"""README is true, and the lines that a newcomer or a technician copies from the terminal run as they are printed."""

import json
import os
import queue
import re
import signal
import socket
import sys
from contextlib import suppress
from pathlib import Path

import pytest

from gateway.client import Client
from gateway.people.client.payloads import leg_payload
from schemas import keys
from schemas.event import Event
from schemas.words import Kind
from tests.support.child import Child
from tests.support.command import parse, run_here, run_program
from tests.support.console_process import LINK
from tests.support.gateway_process import COMMAND, READY, Gateway, free_port
from tests.support.heard import frames
from tests.support.pages import blocks, parse_commands
from tests.support.runs import MARK, Run
from tests.support.waiting import wait_until

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text()
ROBOT = (ROOT / "docs" / "robot.md").read_text()


@pytest.mark.full
def test_the_first_payload_and_the_python_example_work(tmp_path: Path) -> None:
    (code,) = blocks(README, "python")
    (payload,) = re.findall(r"^\| `hexapod/leg/[^`]+` \| in \| `([^`]+)` \|", README, re.MULTILINE)
    with Gateway(tmp_path, {"watchdog": {"timeout_ms": 10_000}}) as gateway:  # this machine may be busy
        with gateway.client() as client:
            assert client.ask("hexapod/leg/3/cmd", json.loads(payload)).accepted, "of a leg that nothing has started"
            assert client.stop().accepted
        code = code.replace("tcp/127.0.0.1:7447", gateway.endpoint)
        assert "ticks missed" in run_program(sys.executable, "-c", code, timeout=120).stdout
        with gateway.client() as client:
            state = client.state()
        # The payload, its Stop; the setpoints, of which a busy gateway takes the newest; the Stops at their end.
        assert 50 < state.commands.accepted <= 2 + 100 + 1
        assert state.commands.rejected == 0
        assert state.watchdog.expirations == 0, "a first program leaves nothing to the watchdog"


@pytest.mark.full
def test_the_second_terminal_works_as_printed(tmp_path: Path) -> None:
    """Its lines, in a shell whose PATH has neither the command nor its Python; only the endpoint is this test's."""
    lines = next(block for block in blocks(README, "console") if "source .venv" in block).splitlines()
    with Gateway(tmp_path, {"watchdog": {"timeout_ms": 10_000}, "lease": {"ttl_ms": 10_000}}) as gateway:
        (tmp_path / ".venv").symlink_to(sys.prefix)
        typed = [line.removeprefix("$ ") for line in lines if line.startswith("$ ")]
        commands = [line.replace("--seconds 5", "--seconds 0.5") for line in typed]
        commands = [f"{each} --connect {gateway.endpoint}" if "hexapod-gateway" in each else each for each in commands]
        commands += ["python -c 'import gateway.client'"]
        environment = {"PATH": "/usr/bin:/bin", "HOME": str(tmp_path)}
        run_program("bash", "-ec", "\n".join(commands), cwd=tmp_path, env=environment, timeout=120)
        with gateway.client() as client:
            assert client.state().commands.accepted > 0


@pytest.mark.full
def test_the_walk_walks(tmp_path: Path) -> None:
    (code,) = blocks((ROOT / "docs" / "walking.md").read_text(), "python")
    with Gateway(tmp_path, {"watchdog": {"timeout_ms": 10_000}, "lease": {"ttl_ms": 10_000}}) as gateway:
        code = code.replace("tcp/127.0.0.1:7447", gateway.endpoint).replace("range(150)", "range(50)")
        code = code.replace("ahead(0.2)", "ahead(0.05)").replace("turn(-1.57)", "turn(-0.2)")
        assert run_program(sys.executable, "-c", code, timeout=120).stdout.startswith("Odometry(x_m=0.")
        with gateway.client() as client:
            assert client.state().commands.rejected == 0


@pytest.mark.full
def test_the_messages_of_a_robot_that_does_not_move_are_real(tmp_path: Path) -> None:
    """Those that a gateway without a fault can be brought to say; docs/robot.md has each, … for what varies."""
    with Gateway(tmp_path) as gateway:

        def said(*arguments: str) -> str:
            end = run_here(*arguments, "--connect", gateway.endpoint)
            return (end.stdout or end.stderr).strip().removeprefix("hexapod-gateway: ")

        told = [said("send", "leg", "4", "set", "10", "20", "30")]
        with gateway.client() as client:
            events: queue.Queue[Event] = queue.Queue()
            client.on_event(events.put)
            assert client.start_leg(3, 90, 45, 120).accepted
            while (event := events.get(timeout=10)).kind is not Kind.WATCHDOG_EXPIRED:
                pass
            told.append(event.detail)
            ack = client.ask("hexapod/leg/7/cmd", leg_payload("start", (90, 45, 120)))
            told.append(f"rejected: {ack.reason}: {ack.detail}")
        said("estop")
        told.append(said("send", "leg", "3", "start", "90", "45", "120"))
    unreachable, _, _ = said("reset").replace(gateway.endpoint.rpartition(":")[2], "7447").partition("→")
    told.append(f"{unreachable}→ …")
    rows = [row.split("…") for row in re.findall(r"^\| `([^`]{20,})`", ROBOT, re.MULTILINE)]
    for message in told:
        assert any(re.fullmatch(".*".join(map(re.escape, row)), message) for row in rows), message


@pytest.mark.full
def test_the_keys_are_the_keys() -> None:
    table = set(re.findall(r"^\| `(hexapod/[^`]+)` \|", README, re.MULTILINE))
    commands = {keys.LEGS_COMMAND, keys.ESTOP, keys.RESET}
    reports = {keys.STATE, keys.CONFIG, keys.EVENT, keys.FRAME, keys.TELEMETRY, keys.ALIVE}
    assert table == commands | reports | {"hexapod/leg/{1..6}/cmd", "hexapod/servo/{11..63}/cmd"}


PAGES = ["README.md", *(f"docs/{page}.md" for page in ("quickstart", "driving", "recordings", "robot", "certificates"))]


@pytest.mark.full
@pytest.mark.parametrize("path", [*PAGES, "docs/stops.md"])
def test_each_command_to_copy_is_the_programs(path: str) -> None:
    """Each with its options and values: a console's line without its remark, and a command alone in `backticks`."""
    page = (ROOT / path).read_text()
    lines = [line.partition(" #")[0] for block in blocks(page, "console") for line in block.splitlines()]
    texts = [line.partition("$ ")[2] for line in lines if line.startswith("$ ")]
    texts += re.findall(r"`((?:sudo )?hexapod-gateway [^`…]+)`", page)
    found = [words for text in texts for words in parse_commands(re.split("[>]", text)[0])]
    assert len(found) >= 8


def test_make_run_keeps_an_incident_finds_a_port_and_ends_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With port 8080 taken; what it prints at last is where the console is. The gateway goes on without the console."""
    monkeypatch.setenv(MARK, os.environ[MARK])  # as it was, afterwards
    run = Run()
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    env = {**os.environ, "XDG_STATE_HOME": str(tmp_path), "HEXAPOD_ZENOH__LISTEN": f'["{endpoint}"]'}
    for name in ("STATE_DIRECTORY", "MAKELEVEL"):  # below another make it would print which folder it enters
        env.pop(name, None)
    start = ["make", "--old-file", f"{sys.prefix}/run", "run", f"VENV={sys.prefix}"]
    with socket.socket() as other:
        with suppress(OSError):  # somebody else may have it already
            other.bind(("127.0.0.1", 8080))
            other.listen()
        child = Child(["setsid", *start], env, cwd=ROOT)
        try:
            child.wait_for_output(READY)
            address = child.wait_for_output(LINK).removeprefix(LINK)
            port = int(address.removeprefix("http://127.0.0.1:").partition("/")[0])
            assert port > 8080
            child.wait_for_output(f"Port 8080 is taken by another program, so the console listens on {port}.")
            assert child.stdout.splitlines()[-1].startswith(LINK)
            walk = child.wait_for_output("or, from the keyboard: ")
            assert walk.rstrip().endswith(f"bin/hexapod-gateway walk --connect {endpoint}")
            child.wait_for_output("Try, in a second terminal: ")
            lines = child.stdout.splitlines()
            begins = ("Try, in a second terminal: ", "or, from the keyboard: ", "For a browser: ")
            commands = [line for line in lines if line.startswith(begins)]
            assert [begin for line in lines for begin in (READY, LINK) if line.startswith(begin)] == [READY, LINK]
            assert len(commands) == len(begins) == len(lines) - 2  # in any order: each program writes its own
            for line in commands:
                parse(line.partition(": ")[2], called=f"{sys.prefix}/bin/hexapod-gateway")
            with Client(endpoint, timeout_s=5) as client:
                seen = frames(client)
                assert client.start_leg(3, 90, 45, 120).accepted
                seen.wait(lambda frame: frame.cause == "watchdog")
            second = run_program(sys.executable, "-m", "gateway.onboard.try_out", "no", env=env, code=4)
            assert (second.stdout, second.stderr.count("\n")) == ("", 1), second
            assert second.stderr.startswith(f"hexapod-gateway: {endpoint} is taken by another program")
            told = run_program(*COMMAND, "check", "--connect", endpoint, env=env).stdout
            assert not re.search("^(failure|warning  SPI)", told, re.MULTILINE), told
            assert told.splitlines()[-1].startswith("This machine can reach the gateway")
            assert "leg 3" in run_program(*COMMAND, "incidents", "show", "last", env=env).stdout
            (console,) = [pid for pid in run.processes() if b"\0console\0" in Path(f"/proc/{pid}/cmdline").read_bytes()]
            os.kill(console, signal.SIGKILL)
            with Client(endpoint, timeout_s=5) as client:
                assert client.state().mode == "idle"
            child.terminate()
            child.wait(20)
            assert "Traceback" not in child.stderr
            wait_until(lambda: not run.processes(), "all have ended: make itself does not wait", 10)
        finally:
            run.close()
            child.close()
