"""What a robot costs a fleet's router: `python -m tests.benchmarks.fleet [SECONDS]`.

The router is a Zenoh session in router mode with the router.json5 that `certs robot` makes, in a process of its own.
The robots are plain Zenoh sessions, all in one other process, each with its robot's own file and certificate: each
publishes a real state (18 servos running) ten times a second and takes commands as the gateway does. Each has an
observer of its own, in a third process: Zenoh sends nothing that nobody wants. An operator of the first robot, here,
puts a leg's setpoints fifty times a second.
"""

import os
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import zenoh
from zenoh.handlers import RingChannel

from gateway import certs
from gateway.client import Client, leg_payload
from gateway.zenoh_config import load_config
from schemas import keys
from schemas.robot import LEGS
from schemas.telemetry import Mode, WatchdogState
from tests.benchmarks.processes import cpu_ns, rss_kb
from tests.support.child import Child
from tests.support.gateway_process import free_port
from tests.support.watch_reports import state

HOST = "127.0.0.1"
SIZES = (1, 10, 30)
STATE_S = 0.1
COMMAND_S = 0.02
READY = "ready"


def main() -> None:
    match sys.argv[1:]:
        case ["router", config]:
            _router(Path(config))
        case ["robots", folder, count]:
            _robots(Path(folder), int(count))
        case ["observers", folder, count]:
            _observers(Path(folder), int(count))
        case arguments:
            _measure(float(arguments[0]) if arguments else 20.0)


def _measure(seconds: float) -> None:
    print(f"a state of {len(_state())} bytes at {1 / STATE_S:g} Hz from each robot, {seconds:g} s each")
    print("| robots | router's CPU (of one core) | router's memory | states/s that arrived | commands/s that arrived |")
    print("|---|---|---|---|---|")
    for size in SIZES:
        print(_row(size, seconds), flush=True)


def _row(size: int, seconds: float) -> str:
    with tempfile.TemporaryDirectory() as name, ExitStack() as end:
        folder, port = Path(name) / "D", free_port()
        certs.folder.init(folder, [HOST], port=port)
        certs.folder.add_robots(folder, [_robot(number) for number in range(size)])
        certs.folder.issue(folder, "operator", "operator", robots=[_robot(0)])
        for number in range(size):
            certs.folder.issue(folder, f"observer-{number}", "observer", robots=[_robot(number)])
        router = _start(end, "router", str(folder / "router.json5"))
        alone_kb = rss_kb(router.pid)
        robots = _start(end, "robots", str(folder), str(size))
        observers = _start(end, "observers", str(folder), str(size))
        operator = end.enter_context(Client(None, zenoh_config=folder / "operator.json5", timeout_s=20))
        operator.state()
        _command(operator, 2.0)  # everything has been used once
        before = [int(child.ask("count")) for child in (robots, observers)]
        start, cpu = time.monotonic(), cpu_ns(router.pid)
        _command(operator, seconds)
        took, cpu = time.monotonic() - start, cpu_ns(router.pid) - cpu
        after = [int(child.ask("count")) for child in (robots, observers)]
        commands, states = ((late - early) / took for early, late in zip(before, after, strict=True))
        memory = rss_kb(router.pid)
        return (
            f"| {size} | {cpu / took / 1e7:.1f} % | {memory / 1024:.1f} MiB "
            f"({(memory - alone_kb) / 1024:.1f} more than alone) | {states:.0f} | {commands:.0f} |"
        )


def _robot(number: int) -> str:
    return f"robot-{number}"


def _start(end: ExitStack, *arguments: str) -> Child:
    child = Child([sys.executable, "-m", "tests.benchmarks.fleet", *arguments], os.environ)
    end.callback(child.close)
    child.wait_for_output(READY, timeout_s=60)
    return child


def _command(operator: Client, seconds: float) -> None:
    due = time.monotonic()
    end = due + seconds
    while due < end:
        operator.publish(keys.leg_command(3), leg_payload("set", (90, 45, 120)))
        due += COMMAND_S
        time.sleep(max(0.0, due - time.monotonic()))


def _router(config: Path) -> None:
    with zenoh.open(load_config(config)):
        print(READY, flush=True)
        sys.stdin.read()


def _robots(folder: Path, count: int) -> None:
    report = _state()
    opened: list[tuple[zenoh.Publisher, Any]] = []
    kept: list[Any] = []
    for number in range(count):
        session = zenoh.open(load_config(folder / f"{_robot(number)}.json5"))
        kept.append(session)
        kept.append(session.liveliness().declare_token(keys.ALIVE))
        kept.append(session.declare_queryable(keys.STATE, lambda query: query.reply(keys.STATE, report)))
        publisher = session.declare_publisher(keys.STATE, congestion_control=zenoh.CongestionControl.DROP)
        opened.append((publisher, session.declare_subscriber(keys.ALL_COMMANDS, RingChannel(1000))))
    print(READY, flush=True)
    commands = 0
    asked = _asked()
    due = time.monotonic()
    while True:
        for publisher, subscriber in opened:
            publisher.put(report, encoding="application/json")
            while subscriber.handler.try_recv() is not None:
                commands += 1
        if asked():
            print(commands, flush=True)
        due += STATE_S
        time.sleep(max(0.0, due - time.monotonic()))


def _observers(folder: Path, count: int) -> None:
    counts = [0] * count
    kept: list[Any] = []
    for number in range(count):
        session = zenoh.open(load_config(folder / f"observer-{number}.json5"))
        kept.append(session)

        def heard(_sample: zenoh.Sample, number: int = number) -> None:
            counts[number] += 1

        kept.append(session.declare_subscriber(keys.STATE, heard))
    print(READY, flush=True)
    for _line in sys.stdin:
        print(sum(counts), flush=True)


def _asked() -> Any:
    os.set_blocking(sys.stdin.fileno(), False)

    def asked() -> bool:
        try:
            return bool(os.read(sys.stdin.fileno(), 100))
        except BlockingIOError:
            return False

    return asked


def _state() -> str:
    """Of a robot whose 18 servos run."""
    counts = (12345, 12, 123)
    one = state(
        1234.5, Mode.ACTIVE, counts=counts, frames=123456, age_ms=12.3, watchdog=WatchdogState.ARMED, running=True
    )
    legs = tuple(one.legs[2].model_copy(update={"leg": leg}) for leg in LEGS)
    return one.model_copy(update={"legs": legs}).model_dump_json()


if __name__ == "__main__":
    main()
