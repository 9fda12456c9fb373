"""Hosts on one machine: a robot and its laptops, each a network namespace, with a link of its own between them.

What a test sees of the robot, and has the laptops do, is in `RobotHost` and `LaptopHost`; other programs begin so:

    with Network() as network:
        endpoint = f"tcp/{network.robot_address(0)}:7447"
        gateway = Gateway(folder, {"zenoh": {"listen": [endpoint], "allow_insecure": True}}, prefix=network.robot)
        laptop = Child([*network.laptop(0), *COMMAND, "status", "--follow", "--connect", endpoint], os.environ)
        network.cut(0)
        network.fix(0)

What a program on the robot sends to a laptop that does not read is delayed soon: buffers that way are small.
Nothing of it shows outside: the links exist in the namespaces only. `ip netns exec` becomes the program that it starts,
so a signal to the child is a signal to that program. Monotonic clocks are the same in all of them.
"""

import itertools
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import Any, Final

import zenoh
from zenoh.handlers import RingChannel

from gateway.client import Client
from gateway.people.client.payloads import leg_payload
from schemas.ack import Ack
from schemas.event import Event, FrameRecord
from schemas.keys import ALIVE, EVENT, FRAME, STATE, leg_command
from schemas.words import Cause
from tests.support.child import Child
from tests.support.gateway_process import Gateway
from tests.support.heard import events, frames, states
from tests.support.waiting import Closing, meanwhile, wait_until

MARK = "hexapod-net"
BUFFER_BYTES = 16_384
_numbers = itertools.count()


class Network(Closing):
    """A robot, and two laptops (0 and 1), each linked to the robot and to nobody else."""

    laptops = range(2)

    def __init__(self) -> None:
        """Create them, and remove what could not be finished. Raises RuntimeError with `ip`'s output."""
        _remove_leftovers()
        name = f"{MARK}-{os.getpid()}-{next(_numbers)}"
        self._robot = f"{name}-robot"
        self._laptops = [f"{name}-laptop{number}" for number in self.laptops]
        try:
            for namespace in (self._robot, *self._laptops):
                _run("ip", "netns", "add", namespace)
                _run("ip", "-n", namespace, "link", "set", "lo", "up")
            for number, namespace in enumerate(self._laptops):
                ours = ("link", "add", _link(number), "netns", self._robot)
                _run("ip", *ours, "type", "veth", "peer", "name", "robot", "netns", namespace)
                self._address(number, self.robot_address(number))
                _run("ip", "-n", namespace, "address", "add", f"{_laptop_address(number)}/24", "dev", "robot")
                _run("ip", "-n", namespace, "link", "set", "robot", "up")
                self.fix(number)
                _limit_buffers(namespace, "tcp_rmem")
            _limit_buffers(self._robot, "tcp_wmem")
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        for namespace in (self._robot, *self._laptops):
            _remove(namespace)

    @property
    def robot(self) -> tuple[str, ...]:
        """Return what goes before a command to run it on the robot."""
        return ("ip", "netns", "exec", self._robot)

    def laptop(self, number: int) -> tuple[str, ...]:
        """Return what goes before a command to run it on that laptop."""
        return ("ip", "netns", "exec", self._laptops[number])

    def robot_address(self, laptop: int) -> str:
        """Return where that laptop reaches the robot."""
        return f"10.77.{laptop}.1"

    def another_address(self, laptop: int) -> str:
        """Return another address by which that laptop reaches the robot from now on."""
        return self._address(laptop, f"10.77.{laptop}.3")

    def _address(self, laptop: int, address: str) -> str:
        _run("ip", "-n", self._robot, "address", "replace", f"{address}/24", "dev", _link(laptop))
        return address

    def ipv6(self, *, on: bool) -> None:
        _run(*self.robot, "sh", "-c", f"echo {int(not on)} >/proc/sys/net/ipv6/conf/all/disable_ipv6")

    def queued_bytes(self, laptop: int) -> int:
        """Return how many bytes that were sent to this laptop are still with the robot's kernel."""
        asked = (*self.robot, "ss", "-Htn", "state", "established", "dst", _laptop_address(laptop))
        lines = _run(*asked).splitlines()
        return sum(int(line.split()[1]) for line in lines)

    def cut(self, laptop: int) -> None:
        """Cut the link between this laptop and the robot. Neither is informed."""
        _run("ip", "-n", self._robot, "link", "set", _link(laptop), "down")

    def fix(self, laptop: int) -> None:
        _run("ip", "-n", self._robot, "link", "set", _link(laptop), "up")


@cache
def lacks() -> str:
    """Return why there can be no network here, in one line; empty when there can."""
    if os.geteuid() != 0:
        return "network namespaces need root"
    if shutil.which("ip") is None:
        return "Debian package missing: iproute2"
    try:
        Network().close()
    except RuntimeError as error:
        return f"no network namespaces here: {error}"
    return ""


def _link(laptop: int) -> str:
    return f"laptop{laptop}"


def _laptop_address(laptop: int) -> str:
    return f"10.77.{laptop}.2"


def _remove_leftovers() -> None:
    """Remove namespaces whose process was killed before it could remove them."""
    for line in _run("ip", "netns", "list").splitlines():
        name = line.split()[0]
        if name.startswith(f"{MARK}-") and not Path("/proc", name.split("-")[2]).exists():
            _remove(name)


def _remove(namespace: str) -> None:
    with suppress(RuntimeError):
        _run("ip", "netns", "delete", namespace)


def _limit_buffers(namespace: str, setting: str) -> None:
    sizes = f"4096 {BUFFER_BYTES} {BUFFER_BYTES}"
    _run("ip", "netns", "exec", namespace, "sh", "-c", f"echo {sizes} > /proc/sys/net/ipv4/{setting}")


def _run(*command: str) -> str:
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=20)
    if done.returncode != 0:
        raise RuntimeError(f"{' '.join(command)}: {done.stderr.strip()}")
    return done.stdout


PORT: Final = 7447
NICE: Final = -10
"""Laptops would have processors of their own, so they come before the rest of this machine."""
PERIOD_S: Final = 0.02
LATE_S: Final = 20
TIMEOUT_MS: Final = 500.0
"""Twice the default, since a laptop on a busy machine may itself be silent for longer than that."""
LEASE_MS: Final = 5000
"""How long a laptop waits for a sign of life from the gateway before it opens a new session."""
RELAY: Final = """
import socket, sys, threading
from contextlib import suppress
def forward(source, sink):
    with suppress(OSError):
        while data := source.recv(65536):
            sink.sendall(data)
    for each in (source, sink):
        with suppress(OSError):
            each.shutdown(socket.SHUT_RDWR)
def relay(near):
    try:
        far = socket.create_connection((sys.argv[2], int(sys.argv[3])), timeout=1)
    except OSError:
        near.close()
        return
    far.settimeout(None)
    for way in ((near, far), (far, near)):
        threading.Thread(target=forward, args=way).start()
listener = socket.socket(socket.AF_UNIX)
listener.bind(sys.argv[1])
listener.listen()
print("relays", flush=True)
while True:
    threading.Thread(target=relay, args=listener.accept()[:1]).start()
"""
"""Connects each client of a Unix socket with the robot."""


class RobotHost(Closing):
    """A gateway that laptops reach over their links, and an observer that stands on the robot itself.

    The observer's way is a Unix socket, which network namespaces leave alone: it sees what happens while links are cut.
    A leg may be commanded far more often than the laptops do it, so that no command waits, and a frame is on the wire
    as soon as its command is accepted. Stops are not repeated: each is one frame. The state comes so often that a
    laptop that no longer reads is soon full. The lease is shorter than Zenoh's own 10 s, so that a laptop gives up
    sooner. Commands have no age limit: what is rejected then shows the other rules.
    """

    def __init__(self, network: Network, folder: Path) -> None:
        observer = f"unixsock-stream/{folder / 'observer.sock'}"
        listen = [f"tcp/{network.robot_address(number)}:{PORT}" for number in network.laptops]
        file = folder / "zenoh.json5"
        file.write_text(f"{{transport: {{link: {{tx: {{lease: {LEASE_MS}}}}}}}}}")
        settings: dict[str, dict[str, Any]] = {
            "zenoh": {"listen": [*listen, observer], "allow_insecure": True, "config": str(file)},
            "telemetry": {"frames": True},
            "limits": {"leg_rate_hz": 1000, "max_age_ms": 0, "takeover_deg_s": 0},
            "watchdog": {"timeout_ms": TIMEOUT_MS},
        }
        with ExitStack() as opened:
            opened.enter_context(Gateway(folder, settings, prefix=network.robot))
            self.client = opened.enter_context(Client(observer, source="observer", timeout_s=5))
            self.frames, self.events = frames(self.client), events(self.client)
            self._states = states(self.client, kept=1)
            self._opened = opened.pop_all()
        self.forget()

    def close(self) -> None:
        self._opened.close()

    def at_rest(self) -> None:
        """Leave an emergency stop, stop everything, and forget all frames and events until now."""
        assert self.client.reset().accepted
        assert self.client.stop().accepted
        self.forget()

    def forget(self) -> None:
        """What is said of frames and events is about those from now on, by their own times.

        What was reported before may still be under way: the gateway answers, reports frames and reports events on
        threads of their own, and so they are heard.
        """
        self._since_ns, self._since = time.monotonic_ns(), datetime.now(UTC)

    @property
    def rejected(self) -> int:
        return self.client.state().commands.rejected

    @property
    def running(self) -> set[int]:
        """Return the legs of which a servo runs."""
        return {leg.leg for leg in self.client.state().legs if any(servo.running for servo in leg.servos)}

    def seen(self, condition: Callable[[FrameRecord], bool]) -> list[FrameRecord]:
        """Such frames of those that were written up to now.

        A state that is published after an answer comes behind the reports of what was written before it. Reports are
        not counted: under a flood, more frames are written than anybody is sent.
        """
        answered_s = self.client.state().uptime_s
        self._states.wait(lambda state: state.uptime_s > answered_s)
        return [frame for frame in self.frames.all if self._is_new(frame) and condition(frame)]

    def wait_for_commands(self, *legs: int, count: int = 5) -> None:
        """Wait until each of these legs has been commanded that often."""
        for leg in legs:
            self._wait(is_command(leg), count)

    def wait_for_stops(self, *legs: int) -> list[float]:
        """Wait until the watchdog has stopped each of these legs. Return how much too late, in ms."""
        for leg in legs:
            self._wait(is_stop(leg), 1)
        return [self._late_ms(leg) for leg in legs]

    def wait_for_event(self, condition: Callable[[Event], bool]) -> Event:
        return self.events.wait(lambda event: event.time > self._since and condition(event))

    def _wait(self, condition: Callable[[FrameRecord], bool], count: int) -> None:
        self.frames.wait(lambda frame: self._is_new(frame) and condition(frame), count=count)

    def _is_new(self, frame: FrameRecord) -> bool:
        return frame.monotonic_ns > self._since_ns

    def _late_ms(self, leg: int) -> float:
        frames = [frame for frame in self.frames.all if self._is_new(frame)]
        stop = next(place for place, frame in enumerate(frames) if is_stop(leg)(frame))
        last = max(frame.monotonic_ns for frame in frames[:stop] if is_command(leg)(frame))
        return (frames[stop].monotonic_ns - last) / 1e6 - TIMEOUT_MS


def is_command(*legs: int) -> Callable[[FrameRecord], bool]:
    """Return whether a frame comes from a command for one of these legs."""
    return lambda frame: frame.cause is Cause.COMMAND and _leg(frame) in legs


def is_stop(*legs: int) -> Callable[[FrameRecord], bool]:
    """Return whether a frame is the watchdog's, for one of these legs."""
    return lambda frame: frame.cause is Cause.WATCHDOG and _leg(frame) in legs


def _leg(frame: FrameRecord) -> int:
    """Return the leg of a frame: its third byte is the servo's id, or that of the leg's first servo."""
    return bytes.fromhex(frame.bytes)[2] // 10


class LaptopHost(Closing):
    """A client of this process, with at most one stream. Its link begins at a relay in the laptop's namespace.

    It also subscribes to all that the gateway reports.
    """

    def __init__(self, network: Network, number: int, folder: Path) -> None:
        self.source = f"laptop {number}"
        near = folder / "relay.sock"
        first = ("nice", "-n", str(NICE), *network.laptop(number), sys.executable, "-c", RELAY)
        self.relay = Child([*first, str(near), network.robot_address(number), str(PORT)], os.environ)
        self.relay.wait_for_output("relays")
        self.client = Client(f"unixsock-stream/{near}", source=self.source, timeout_s=LATE_S)
        self.sent = 0
        """Setpoints of all its streams."""
        self.answers: list[tuple[float, Ack]] = []
        """To those of the last acknowledged stream, and when they came (monotonic, s)."""
        self._step = itertools.count()
        self._stream = ExitStack()
        self._alive = False
        session = self.client.session
        self._declared: list[Any] = [
            *(session.declare_subscriber(key, RingChannel(1)) for key in (STATE, EVENT, FRAME)),
            session.liveliness().declare_subscriber(ALIVE, self._take_alive, history=True),
        ]

    def close(self) -> None:
        self.pause()
        self.client.close()
        self.relay.close()

    def start(self, *legs: int) -> None:
        assert all(self.client.start_leg(leg, *self._pose(), check=False).accepted for leg in legs)

    def stream(self, *legs: int) -> None:
        """Publish a setpoint for each of these legs 50 times a second, fire and forget."""

        def publish() -> None:
            for leg in legs:
                self.client.publish(leg_command(leg), leg_payload("set", self._pose()))
                self.sent += 1

        self._stream.enter_context(meanwhile(publish, PERIOD_S))

    def ask(self, *legs: int) -> None:
        """Ask for an acknowledged setpoint 50 times a second, for one of these legs after the other."""
        self.answers.clear()
        each = itertools.cycle(legs)

        def ask() -> None:
            answer = self.client.set_leg(next(each), *self._pose(), check=False)
            self.answers.append((time.monotonic(), answer))
            self.sent += 1

        self._stream.enter_context(meanwhile(ask, PERIOD_S))

    def wait_until_sent(self, more: int) -> None:
        enough = self.sent + more
        wait_until(lambda: self.sent >= enough, f"{self.source} sends {more} more")

    def pause(self) -> None:
        """End its streams."""
        self._stream.close()

    def wait_for_reach(self, *, within: bool) -> None:
        """Wait until Zenoh has given the gateway up, or has found it again."""
        wait_until(lambda: self._alive is within, f"{self.source}, within reach: {within}", LATE_S)

    def _take_alive(self, sample: zenoh.Sample) -> None:
        self._alive = sample.kind == zenoh.SampleKind.PUT

    def _pose(self) -> tuple[float, float, float]:
        """Return a pose that never comes twice in a row."""
        return (45 + next(self._step) % 9000 / 100, 60, 90)
