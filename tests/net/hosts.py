"""The robot and a laptop as programs in their namespaces."""

import json
import os
import sys
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, ExitStack
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from gateway.client import Client
from schemas.robot import LEGS
from schemas.telemetry import Cause, FrameRecord
from tests.child import Child
from tests.gateway_process import Gateway
from tests.heard import events, frames
from tests.net.namespaces import Network

PORT = 7447
NO_REPEATS = 0


class Robot(AbstractContextManager["Robot"]):
    """A gateway that laptops reach over their links, and an observer that stands on the robot itself.

    The observer's way is a Unix socket, which network namespaces leave alone: it sees what happens while links are cut.
    A leg may be commanded far more often than the laptops do it, so that no command waits, and a frame is on the wire
    as soon as its command is accepted.
    """

    def __init__(self, network: Network, folder: Path, settings: Mapping[str, Mapping[str, Any]]) -> None:
        socket = f"unixsock-stream/{folder / 'robot.sock'}"
        listen = [*(f"tcp/{network.robot_address(number)}:{PORT}" for number in network.laptops), socket]
        sections: dict[str, dict[str, Any]] = {
            "zenoh": {"listen": listen, "allow_insecure": True},
            "telemetry": {"frames": True},
            "limits": {"leg_rate_hz": 1000, **settings.get("limits", {})},
            "watchdog": {"repeats": NO_REPEATS, **settings.get("watchdog", {})},
        }
        with ExitStack() as opened:
            opened.enter_context(Gateway(folder, sections, prefix=network.robot))
            self.client = opened.enter_context(Client(socket, source="observer", timeout_s=5))
            self.frames = frames(self.client)
            self.events = events(self.client)
            self._close = opened.pop_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._close.close()

    @property
    def rejected(self) -> int:
        """How many commands it has refused."""
        return self.client.state().commands.rejected

    @property
    def running(self) -> set[int]:
        """The legs of which a servo runs."""
        return {leg.leg for leg in self.client.state().legs if any(servo.running for servo in leg.servos)}

    def wait_for_commands(self, since: int, *legs: int, count: int = 5) -> None:
        """Wait until each of these legs has been commanded that often, from the frame with that index on."""
        for leg in legs:
            self.wait_for_frames(since, lambda frame, leg=leg: commands(frame, leg), count)  # type: ignore[misc]

    def wait_for_stops(self, since: int, *legs: int) -> dict[int, float]:
        """Wait until the watchdog has stopped each of these legs; how long after its last command, in ms."""
        for leg in legs:
            self.wait_for_frames(since, lambda frame, leg=leg: is_stop(frame, leg), 1)  # type: ignore[misc]
        frames = self.frames.all[since:]
        return {leg: _silence_ms(frames, leg) for leg in legs}

    def wait_for_frames(self, since: int, condition: Callable[[FrameRecord], bool], count: int) -> None:
        """Wait for that many such frames, from the frame with that index on."""
        before = sum(condition(frame) for frame in self.frames.all[:since])
        self.frames.wait(condition, count=before + count)


def leg_of(frame: FrameRecord) -> int:
    """The leg that a frame is for: the third byte is a leg's first servo, or the servo."""
    return bytes.fromhex(frame.bytes)[2] // 10


def commands(frame: FrameRecord, leg: int) -> bool:
    return frame.cause is Cause.COMMAND and leg_of(frame) == leg


def is_stop(frame: FrameRecord, leg: int) -> bool:
    return frame.cause is Cause.WATCHDOG and leg_of(frame) == leg


def _silence_ms(frames: list[FrameRecord], leg: int) -> float:
    stop = next(place for place, frame in enumerate(frames) if is_stop(frame, leg))
    last = max(frame.monotonic_ns for frame in frames[:stop] if commands(frame, leg))
    return (frames[stop].monotonic_ns - last) / 1e6


class Laptop(AbstractContextManager["Laptop"]):
    """A publisher in its namespace; see `tests.net.publisher` for what can be asked of it."""

    def __init__(self, network: Network, number: int, *, lease_ms: int = 10_000) -> None:
        endpoint = f"tcp/{network.robot_address(number)}:{PORT}"
        command = [sys.executable, "-m", "tests.net.publisher", endpoint, "--source", f"laptop {number}"]
        self.child = Child([*network.laptop(number), *command, "--lease-ms", str(lease_ms)], os.environ)
        self.source = f"laptop {number}"
        self.child.wait_for_line(0, 20)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.child.close()

    def ask(self, line: str) -> dict[str, Any]:
        """What it answers. Raises AssertionError when the gateway did not answer it."""
        answer: dict[str, Any] = json.loads(self.child.ask(line, 20))
        assert "error" not in answer, f"{line}: {answer['error']}"
        return answer

    def start(self, *legs: int) -> None:
        """Energise these legs."""
        assert self.ask(f"start {_list(legs)}") == {"accepted": [True] * len(legs)}

    def stream(self, *legs: int, op: str = "set") -> None:
        """From now on 50 setpoints a second for each of these legs, or starts."""
        self.ask(f"stream {op} {_list(legs)}")


def _list(legs: tuple[int, ...]) -> str:
    return " ".join(map(str, legs or LEGS))
