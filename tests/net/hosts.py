"""The robot and a laptop as programs in their namespaces."""

import json
import os
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Self

from gateway.client import Client
from schemas.telemetry import Cause, Event, FrameRecord
from tests.net.namespaces import Network
from tests.support.child import Child
from tests.support.closing import Closing
from tests.support.gateway_process import Gateway
from tests.support.heard import events, frames, states

PORT = 7447
ANSWER_S = 20
TIMEOUT_MS = 500.0
"""Twice the default, since a laptop on a busy machine may itself be silent for longer than that."""
LEASE_MS = 5000
"""How long a laptop waits for a sign of life from the gateway before it opens a new session."""


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
            "limits": {"leg_rate_hz": 1000, "max_age_ms": 0},
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
        """No emergency stop, nothing runs; forget all frames and events until now."""
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
        """How many commands it has rejected."""
        return self.client.state().commands.rejected

    @property
    def running(self) -> set[int]:
        """The legs of which a servo runs."""
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
        """Wait until the watchdog has stopped each of these legs; how much later than it should have, in ms."""
        for leg in legs:
            self._wait(is_stop(leg), 1)
        return [self._late_ms(leg) for leg in legs]

    def wait_for_event(self, condition: Callable[[Event], bool]) -> Event:
        """Wait for such an event."""
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
    """Whether a frame comes from a command for one of these legs."""
    return lambda frame: frame.cause is Cause.COMMAND and _leg(frame) in legs


def is_stop(*legs: int) -> Callable[[FrameRecord], bool]:
    """Whether a frame is the watchdog's, for one of these legs."""
    return lambda frame: frame.cause is Cause.WATCHDOG and _leg(frame) in legs


def _leg(frame: FrameRecord) -> int:
    """A frame's third byte is the servo's id, or that of the leg's first servo."""
    return bytes.fromhex(frame.bytes)[2] // 10


class LaptopHost(Closing):
    """A publisher in its namespace; see `tests.net.publisher` for what can be asked of it."""

    def __init__(self, network: Network, number: int) -> None:
        """Start it; it is connected when it is first used, or after `ready`."""
        self.source = f"laptop {number}"
        endpoint = f"tcp/{network.robot_address(number)}:{PORT}"
        command = [*network.laptop(number), sys.executable, "-m", "tests.net.publisher", endpoint, self.source]
        self.child = Child(command, os.environ)

    def close(self) -> None:
        self.child.close()

    def ready(self) -> Self:
        """Wait until it is connected."""
        self.child.wait_for_line(0, ANSWER_S)
        return self

    def ask(self, what: str, *arguments: object, **named: object) -> Any:
        """What it answers. Raises AssertionError where that is an error."""
        self.ready()
        answer = json.loads(self.child.ask(json.dumps([what, arguments, named]), ANSWER_S))
        assert "error" not in answer, f"{what}: {answer['error']}"
        return answer["ok"]

    def wait_for_answer(self) -> None:
        """Wait until the gateway answers again; what was asked of a session that ended meanwhile is lost."""
        for _ in range(3):
            with suppress(AssertionError):
                self.ask("wait_for_reach", within=True)
                self.ask("request", "state")
                return
        raise AssertionError(f"{self.source} hears nothing of the gateway")

    def start(self, *legs: int) -> None:
        """Energise these legs."""
        assert self.ask("start", *legs) == [True] * len(legs)

    def stream(self, *legs: int) -> None:
        """From now on 50 setpoints a second for each of these legs."""
        self.ask("stream", *legs)
