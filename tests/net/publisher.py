"""A laptop: streams setpoints to a gateway, and does what lines on its standard input say.

    python -m tests.net.publisher ENDPOINT --source NAME [--lease-ms MS]

Each line is answered by one line of JSON:

    start LEGS…         energise these legs, acknowledged: {"accepted": [bool, …]}
    stream OP LEGS…     from now on, 50 times a second, fire and forget: `set` or `start` for each of these legs
    ask LEGS…           from now on, 50 times a second, an acknowledged set for one of these legs after the other
    flood LEGS…         from now on, sets for these legs as fast as it can
    pause               no more of that; what was sent: see `Sent`
    stop                stop all six legs, acknowledged
    estop               engage the emergency stop, acknowledged
    state               the gateway's state
"""

import argparse
import json
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from itertools import cycle
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from gateway.client import Client, leg_payload
from gateway.errors import ZenohError
from schemas.keys import leg_command

PERIOD_S = 0.02


@dataclass
class Sent:
    """What was sent since the stream began, and what came back of it."""

    sent: int = 0
    accepted: int = 0
    refused: int = 0
    unanswered: int = 0
    last_ns: int = 0
    """When the last one was sent, on the monotonic clock."""
    longest_gap_ms: float = 0
    """Between two that were sent, or two that were answered."""


class Laptop:
    """A client of a gateway, with at most one stream."""

    def __init__(self, client: Client) -> None:
        self._client = client
        self._thread = threading.Thread()
        self._paused = threading.Event()
        self._sent = Sent()
        self._step = 0

    def do(self, line: str) -> Any:
        """Do what the line says; the answer."""
        word, *rest = line.split()
        match word:
            case "start":
                return {"accepted": [self._client.start_leg(int(leg), *self._angles()).accepted for leg in rest]}
            case "stream" | "ask" | "flood" | "pause":
                return self._stream(word, rest)
            case "stop" | "estop" | "state":
                return getattr(self._client, word)().model_dump(mode="json")
        raise ValueError(f"no such command: {line}")

    def _stream(self, word: str, rest: Sequence[str]) -> Any:
        self.pause()
        match word:
            case "stream":
                self._begin(lambda: self._publish(rest[0], rest[1:]), PERIOD_S)
            case "ask":
                turns = cycle(rest)
                self._begin(lambda: self._ask(next(turns)), PERIOD_S)
            case "flood":
                self._begin(lambda: self._publish("set", rest), 0)
        return asdict(self._sent)

    def pause(self) -> None:
        """End the stream, if there is one."""
        if self._thread.is_alive():
            self._paused.set()
            self._thread.join()

    def _begin(self, send: Callable[[], None], period_s: float) -> None:
        self._sent = Sent()
        self._paused.clear()
        self._thread = threading.Thread(target=self._run, args=(send, period_s))
        self._thread.start()

    def _run(self, send: Callable[[], None], period_s: float) -> None:
        due_s = time.monotonic()
        while not self._paused.is_set():
            send()
            now_ns = time.monotonic_ns()
            if self._sent.last_ns:
                self._sent.longest_gap_ms = max(self._sent.longest_gap_ms, (now_ns - self._sent.last_ns) / 1e6)
            self._sent.last_ns = now_ns
            if period_s:
                due_s = max(due_s + period_s, time.monotonic())  # a missed turn is skipped, never made up
                self._paused.wait(due_s - time.monotonic())

    def _publish(self, op: str, legs: Sequence[str]) -> None:
        for leg in legs:
            self._client.publish(leg_command(int(leg)), leg_payload(op, self._angles()))
            self._sent.sent += 1

    def _ask(self, leg: str) -> None:
        self._sent.sent += 1
        try:
            accepted = self._client.set_leg(int(leg), *self._angles()).accepted
        except ZenohError:
            self._sent.unanswered += 1
        else:
            self._sent.accepted += accepted
            self._sent.refused += not accepted

    def _angles(self) -> tuple[float, float, float]:
        """Never the same twice in a row."""
        self._step = (self._step + 1) % 9000
        return (45 + self._step / 100, 60, 90)


@contextmanager
def connect(endpoint: str, source: str, lease_ms: int) -> Iterator[Client]:
    """A client whose link ends after that long without a sign of life."""
    with TemporaryDirectory() as folder:
        config = Path(folder) / "zenoh.json5"
        config.write_text(json.dumps({"mode": "client", "transport": {"link": {"tx": {"lease": lease_ms}}}}))
        with Client(endpoint, zenoh_config=config, source=source, timeout_s=5) as client:
            yield client


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("endpoint")
    parser.add_argument("--source", required=True)
    parser.add_argument("--lease-ms", type=int, default=10_000)
    arguments = parser.parse_args()
    with connect(arguments.endpoint, arguments.source, arguments.lease_ms) as client:
        laptop = Laptop(client)
        print("{}", flush=True)
        for line in sys.stdin:
            try:
                answer = laptop.do(line)
            except ZenohError as error:
                answer = {"error": str(error)}
            print(json.dumps(answer), flush=True)
        laptop.pause()


if __name__ == "__main__":
    main()
