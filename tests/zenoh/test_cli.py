"""The commands as a person types them: what they print, and their exit codes."""

import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from gateway.client import Client
from gateway.people.commands.reach import me
from schemas.words import Cause, Kind, Mode
from tests.support.command import program, run_here
from tests.support.fixtures import client_fixture, gateway_fixture
from tests.support.gateway_process import COMMAND, Gateway, free_port
from tests.support.heard import events, frames

pytestmark = pytest.mark.usefixtures("client")
NOBODY = ("--connect", f"tcp/127.0.0.1:{free_port()}", "--timeout", "0.5")

LEG_STOPS = [f"{joint:02x}0200" for joint in (11, 21, 31, 41, 51, 61)]
"""What a Stop of each leg begins with."""

gateway = gateway_fixture({"telemetry": {"frames": True}})


client = client_fixture(None, rests=True)


@pytest.mark.parametrize(
    ("arguments", "said", "frames_written"),
    [
        ("send leg 3 start 90 45 120", "accepted", ["0e011f015a0020012d0021017800"]),
        ("send leg 3 stop", "accepted", ["0e011f0200002002000021020000"]),
        # Another servo than the leg's: soon behind its Stop, one goes to its target at a limited speed.
        ("send servo 12 start 12.345", "accepted", ["06020c010c22"]),
        ("send servo 32 stop", "accepted", ["060220020000"]),
        ("stop", "all six legs are stopped", [f"0e01{leg}" for leg in LEG_STOPS]),
        ("send legs start 90 45 120", "accepted", ["0e01"] * 6),
        ("send legs start" + 6 * " 90 45 120", "accepted", ["0e01"] * 6),
        ("send legs stop", "accepted", [f"0e01{leg}" for leg in LEG_STOPS]),
    ],
)
def test_each_send_command_writes_its_frames(
    gateway: Gateway, client: Client, arguments: str, said: str, frames_written: list[str]
) -> None:
    heard = frames(client)
    end = gateway.run(*arguments.split())
    assert (end.returncode, end.stdout) == (0, f"{said}\n"), end
    heard.wait_for_all(
        lambda records: all(
            sum(each.cause is Cause.COMMAND and each.bytes.startswith(begins) for each in records)
            >= frames_written.count(begins)
            for begins in frames_written
        )
    )
    hint = "The watchdog stops it 250 ms after a command; --hold S repeats it"
    assert (hint in end.stderr) is (" start " in arguments)


def test_hold_keeps_a_leg_running_past_the_watchdog(tmp_path: Path) -> None:
    # On a busy machine a command may come late, but hardly by a second.
    settings: dict[str, dict[str, Any]] = {"watchdog": {"timeout_ms": 1000}, "telemetry": {"frames": True}}
    with Gateway(tmp_path, settings) as gateway, gateway.client() as client:
        heard = frames(client)
        end = gateway.run("send", "leg", "3", "start", "90", "45", "120", "--hold", "1.5")
        assert end.returncode == 0
        assert "Held for 1.5 s" in end.stderr
        stop = heard.wait(lambda record: record.cause == "watchdog")
        commands = [record for record in heard.all if record.cause == "command"]
        assert len(commands) > 3, "more often than it must"
        assert commands[0].bytes == "0e011f015a0020012d0021017800"
        others = {record.bytes for record in commands[1:]} - {"0e011f0200002002000021020000"}
        assert others == {"0e011f035a0020032d0021037800"}, "it is started once, and then set"
        assert stop.monotonic_ns - commands[0].monotonic_ns > 1_500_000_000
        for number in (signal.SIGINT, signal.SIGTERM):
            heard = frames(client)
            with gateway.begin("send", "leg", "3", "start", "90", "45", "120", "--hold", "60") as child:
                heard.wait(lambda record: record.cause == "command")
                child.send_signal(number)
                assert child.wait() == 130
            assert client.state().lease.holder is None, "it is released"


def test_estop_and_reset_report_their_effect_and_name_the_person(gateway: Gateway, client: Client) -> None:
    end = gateway.run("estop")
    assert end.returncode == 0
    assert re.fullmatch(r"stopped: 6 Stop frames written within \d+ µs of the request\n", end.stdout)
    stopped = gateway.run("stop")
    assert (stopped.returncode, stopped.stdout) == (0, "all six legs are stopped already, by the emergency stop\n")
    rejected = gateway.run("send", "leg", "3", "start", "1", "2", "3")
    walked = gateway.run("walk", "--seconds", "1")
    for each in (rejected, walked):
        assert (each.returncode, each.stdout.split(":")[1]) == (1, " estopped")
        assert each.stderr.endswith(f"until `hexapod-gateway reset --connect {gateway.endpoint}`.\n"), each
    state, heard = client.state(), events(client)
    assert (state.mode, state.estop_source) == (Mode.ESTOPPED, f"{me()[:40]} (hexapod-gateway estop)")
    end = gateway.run("reset")
    reset = heard.wait(lambda event: event.kind == Kind.ESTOP_RESET)
    assert (end.returncode, end.stdout) == (0, "reset; nothing moves until it is started again\n")
    assert reset.source == f"{me()[:40]} (hexapod-gateway reset)"


@pytest.mark.parametrize(
    ("prefix", "environment", "said"),
    [
        # A limit for files is one for shared memory, too; as is a full or read-only /dev/shm.
        pytest.param(["sh", "-c", 'ulimit -f 0; exec "$@"', "sh"], {}, "µs of", id="without room in /dev/shm"),
        pytest.param([], {"PYTHONIOENCODING": "ascii"}, "\\xb5s of", id="a terminal without the characters"),
        pytest.param([], {"LOGNAME": "an\udce9"}, "µs of", id="a user whose name is no UTF-8"),
    ],
)
def test_a_stop_needs_no_room_no_characters_and_no_name(
    gateway: Gateway, prefix: list[str], environment: dict[str, str], said: str
) -> None:
    command = [*prefix, *COMMAND, "estop", "--connect", gateway.endpoint]
    end = subprocess.run(command, env=os.environ | environment, capture_output=True, text=True, check=False)
    assert end.returncode == 0, end
    assert "stopped: 6 Stop frames written within" in end.stdout
    assert said in end.stdout


START_EXAMPLE = "for example: hexapod-gateway send leg 3 start 90 45 120"
NOT_RUNNING = "servo_stopped: servo 41 does not run; start it before you set it"


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        ("send leg 4 set 1 2 3", 1, f"rejected: {NOT_RUNNING}"),
        ("send leg 4 start 1 2 200", 1, "rejected: invalid: joint 3: 200° is not between 0 and 180°"),
        ("send leg 7 stop", 2, "less than or equal to 6"),
        ("send leg 3 wave", 2, "Invalid value for 'OP': 'wave' is not one of 'start', 'set', 'stop'."),
        ("send leg 3 start 90", 2, f"there are 1; {START_EXAMPLE}"),
        ("send leg 3 stop 90", 2, "stop takes no angles, and there are 1; for example: hexapod-gateway send leg 3 "),
        ("send legs start 90 45", 2, "start takes 3 angles, or 18, and there are 2; for example: "),
        ("send servo 14 stop", 2, "servo 14 does not exist"),
        ("send servo 32 set", 2, "there are 0; for example: hexapod-gateway send servo 32 set 90"),
        ("send servo 32 stop 5", 2, "there are 1; for example: hexapod-gateway send servo 32 stop"),
        ("run --config /nowhere.toml", 2, "/nowhere.toml: there is no such file"),
        ("stop-servos --config /nowhere.toml", 2, "/nowhere.toml: there is no such file"),
        ("stop --zenoh-config /nowhere.json5", 2, "/nowhere.json5"),
        ("record", 2, ".mcap"),
        ("record --csv --live", 2, ".mcap"),
        ("record ride.bag", 2, ".mcap"),
        ("check --stops --only nonsense", 2, "no step nonsense; there are command, "),
        ("check --config . --zenoh-config .", 2, "name one of them"),
        ("check --unplug", 2, "--only, --restart and --unplug go with --stops"),
        ("frobnicate", 2, "No such command"),
        ("start", 2, "start is a word of `send`: hexapod-gateway send leg 3 start 90 45 120; to stand up"),
        ("send leg 4 set 1.5 0.7 2", 1, "Angles are in degrees, 0 to 180. These look like radians."),
        ("setup --dry-run", 2, "setup is a command of the Debian package"),
        *((arguments, 4, "") for arguments in ("send leg 3 stop", "send servo 32 stop", "stop", "estop", "reset")),
        ("record no-gateway.mcap", 4, ""),
    ],
)
def test_what_cannot_be_done_has_its_exit_code_and_says_what_is_right(
    gateway: Gateway, arguments: str, code: int, said: str
) -> None:
    where = {1: ("--connect", gateway.endpoint), 4: NOBODY}.get(code, ())
    end = run_here(*arguments.split(), *where)
    assert end.returncode == code, end
    assert said in " ".join((end.stdout + end.stderr).split())
    assert "Traceback" not in end.stderr
    assert code != 4 or len(end.stderr.splitlines()) == 1
    assert not Path("no-gateway.mcap").exists()


def helps(command: Any, above: str = "", name: str = "hexapod-gateway") -> Iterator[tuple[str, str, Any]]:
    """Yield each command's name, its help with that of the groups around it, and its parameters."""
    text = f"{above}{command.help}"
    for part, each in getattr(command, "commands", {}).items():
        yield from helps(each, text, f"{name} {part}")
    if not hasattr(command, "commands"):
        yield name, text, command.params


def test_help_teaches_every_option_and_the_exit_codes_once() -> None:
    for name, text, parameters in helps(program()):
        assert "xit code" not in text, name
        assert all(each.help for each in parameters), name
    assert "Exit codes: 0 done" in run_here("--help").stdout
    assert "<operator|observer|button|" in run_here("certs", "issue", "--help").stdout


def test_ctrl_c_during_loading_prints_no_traceback(tmp_path: Path) -> None:
    (tmp_path / "typer.py").write_text("raise KeyboardInterrupt\n")
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    end = subprocess.run([*COMMAND, "stop"], env=environment, capture_output=True, text=True, check=False, timeout=60)
    assert (end.returncode, end.stdout, end.stderr) == (130, "", "")


BUSY_DAEMON = """
import sys, threading, zenoh
from gateway import cli
def busy(**_):
    config = zenoh.Config.from_json5('{listen: {endpoints: []}, scouting: {multicast: {enabled: false}}}')
    session = zenoh.open(config)
    publisher = session.declare_publisher("a")
    begun = threading.Event()
    def publish():
        while True:
            publisher.put(b"")
            begun.set()
    threading.Thread(target=publish, daemon=True).start()
    begun.wait()
    print("shown")
    sys.exit(3)
cli.app = busy
cli.main()
"""


def test_a_command_ends_with_its_own_exit_code_though_a_thread_of_it_is_inside_zenoh() -> None:
    """Python's own end would abort the process when the thread returns from Zenoh."""
    ended = subprocess.run([sys.executable, "-c", BUSY_DAEMON], capture_output=True, text=True, timeout=60, check=False)
    assert (ended.returncode, ended.stdout, ended.stderr) == (3, "shown\n", "")
