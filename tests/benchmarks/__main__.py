"""The benchmark: what setpoints and idling cost this gateway and a naive script, in processor time and latency.

Both run at once, and one publisher gives each a slice of traffic in turn. Both write to a device that answers at once
(instant_spidev.c). Within a second a machine changes its pace, and with it all figures; the ratio of two slices that
follow each other stays. Processor time is that of all threads (schedstat).
"""

import json
import mmap
import os
import platform
import random
import shutil
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from typing import Any, Final, NamedTuple

import zenoh

from gateway.zenoh_config import client_config
from schemas.keys import LEGS_COMMAND, leg_command
from schemas.robot import LEGS
from tests.benchmarks.processes import cpu_ns, never_delay
from tests.support.child import Child
from tests.support.gateway_process import COMMAND, READY, free_port, write_settings

NAIVE, GATEWAY = "naive", "gateway"
SLICES, SLICE_S, HZ = 8, 1.0, 50
TIMEOUT_MS, IDLE_S, IDLE_AIM = 10_000, 5.0, 0.3
_SOURCE: Final = Path(__file__).with_name("instant_spidev.c")
_NOTES_AT, _NOTE = 4096, struct.Struct("<QB15s8x")
_ANGLES = 180_00
"""A message's number is the angle of joint 1 in hundredths."""


class Stream(NamedTuple):
    """One kind of traffic; the aims are what the gateway may take of the naive script's."""

    name: str
    whole: bool
    """All legs in one message, as the client's stream sends them."""
    cpu_aim: float
    p50_aim: float


STREAMS: Final = (
    Stream("six legs, a message each", False, 2.2, 1.5),
    Stream("six legs in one message", True, 2.7, 1.4),
)


@dataclass(slots=True)
class Figures:
    """What the slices of one have given: µs of processor a message, share of a core in %, and latencies in µs."""

    cpu_us: list[float] = field(default_factory=list)
    core: list[float] = field(default_factory=list)
    latency_us: list[float] = field(default_factory=list)

    @property
    def p50_us(self) -> float:
        return median(self.latency_us)


class Runner:
    """One of the two, running on a device of its own."""

    def __init__(self, name: str, stream: Stream, folder: Path, stack: ExitStack) -> None:
        self.name, self._whole, self._count, self.figures = name, stream.whole, 0, Figures()
        endpoint, notes = f"tcp/127.0.0.1:{free_port()}", folder / "notes"
        env = {**os.environ, "LD_PRELOAD": str(folder.parent / "instant_spidev.so"), "NOTES": str(notes)}
        if name == NAIVE:
            command, ready = [sys.executable, "-m", "tests.benchmarks.naive", endpoint], "ready"
        else:
            settings: dict[str, dict[str, Any]] = {
                "zenoh": {"listen": [endpoint]},
                "spi": {"framing": "plain"},
                "limits": {"leg_rate_hz": 250},
                "watchdog": {"timeout_ms": TIMEOUT_MS},
                "lease": {"ttl_ms": TIMEOUT_MS},
                "state": {"path": str(folder / "state")},
            }
            config = write_settings(folder / "gateway.toml", settings)
            command, ready = [*COMMAND, "run", "--config", str(config)], READY
        child = Child(["env", *command], env)  # a fork of the tests' fork server would not load the library
        stack.callback(child.close)
        child.wait_for_output(ready, timeout_s=30)
        self.pid = child.pid
        self._notes = stack.enter_context(_mapped(notes))
        session = stack.enter_context(zenoh.open(client_config(endpoint)))
        self._publishers = [
            session.declare_publisher(key, encoding="application/json", express=True)
            for key in ([LEGS_COMMAND] if stream.whole else map(leg_command, LEGS))
        ]
        for leg in LEGS:
            session.put(leg_command(leg), json.dumps(_leg("start", 0)), encoding="application/json")
            time.sleep(0.05)
        time.sleep(0.5)

    def slice(self, *, counts: bool) -> None:
        """Publish for SLICE_S, and note what it cost."""
        sent_ns: dict[int, int] = {}
        first, begun_ns, begun_cpu_ns = self._seen(), time.monotonic_ns(), cpu_ns(self.pid)
        period_s = 1 / HZ / len(self._publishers)
        messages = round(SLICE_S / period_s)
        for number in range(messages):
            time.sleep(max(0.0, begun_ns / 1e9 + number * period_s - time.monotonic()))
            self._count += 1
            cdeg = self._count % _ANGLES
            sent_ns[cdeg] = self._send(number % len(self._publishers), cdeg)
        time.sleep(0.05)
        took_ns, used_ns = time.monotonic_ns() - begun_ns, cpu_ns(self.pid) - begun_cpu_ns
        if not counts:
            return
        self.figures.cpu_us.append(used_ns / 1000 / messages)
        self.figures.core.append(100 * used_ns / took_ns)
        last = LEGS[-1] if self._whole else None
        for at_ns, frame in self._notes_since(first):
            if len(frame) >= 14 and frame[3] == 3 and last in (None, frame[2] // 10):
                begun = sent_ns.pop(frame[4] * 100 + frame[5], None)
                if begun is not None:
                    self.figures.latency_us.append((at_ns - begun) / 1000)

    def _send(self, index: int, cdeg: int) -> int:
        """Send the next message. Returns when."""
        now_ns = time.monotonic_ns()
        body = {"legs": {str(leg): _leg("set", cdeg) for leg in LEGS}} if self._whole else _leg("set", cdeg)
        self._publishers[index].put(json.dumps({**body, "source": "publisher", "sent_ms": now_ns / 1e6}))
        return now_ns

    def _seen(self) -> int:
        return int.from_bytes(self._notes[:8], "little")

    def _notes_since(self, first: int) -> Iterator[tuple[int, bytes]]:
        most = (len(self._notes) - _NOTES_AT) // _NOTE.size
        for number in range(first, self._seen()):
            at_ns, length, data = _NOTE.unpack_from(self._notes, _NOTES_AT + number % most * _NOTE.size)
            yield at_ns, data[:length]


def _leg(op: str, cdeg: int) -> dict[str, Any]:
    """A leg's setpoint that carries a number in joint 1's angle."""
    return {"servos": [{"op": op, "angle_deg": each} for each in (cdeg / 100, 90, 90)]}


@contextmanager
def _mapped(path: Path) -> Iterator[mmap.mmap]:
    with path.open("r+b") as file, mmap.mmap(file.fileno(), 0) as notes:
        yield notes


def compare(stream: Stream, folder: Path) -> None:
    """Print what this stream costs the gateway and the naive script."""
    with ExitStack() as stack:
        runners = []
        for name in (NAIVE, GATEWAY):
            own = folder / name
            shutil.rmtree(own, ignore_errors=True)
            own.mkdir()
            runners.append(Runner(name, stream, own, stack))
        for number in range(SLICES + 1):  # the first counts for nothing: what is slow only once
            for runner in random.sample(runners, len(runners)):
                runner.slice(counts=number > 0)
        idle = [] if stream.whole else _idle([runner.pid for runner in runners])
    naive, ours = (runner.figures for runner in runners)
    ratios = [our / their for our, their in zip(ours.cpu_us, naive.cpu_us, strict=True)]
    times = median(ratios)
    print(
        f"{stream.name}: processor time a message {median(ours.cpu_us):.0f} and {median(naive.cpu_us):.0f} µs: "
        f"{times:.2f}× ({min(ratios):.2f} to {max(ratios):.2f}), {_met(times, stream.cpu_aim)}; "
        f"of a core {median(ours.core):.1f} and {median(naive.core):.1f} %"
    )
    times = ours.p50_us / naive.p50_us
    print(
        f"{stream.name}: publish → frame, p50, {ours.p50_us:.0f} and {naive.p50_us:.0f} µs: "
        f"{times:.2f}×, {_met(times, stream.p50_aim)}"
    )
    if idle:
        print(f"idle: of a core {idle[1]:.2f} and {idle[0]:.2f} %, {_met(idle[1], IDLE_AIM)}")


def _met(found: float, aim: float) -> str:
    return f"aim {aim:g} {'met' if found <= aim else 'NOT MET'}"


def _idle(pids: list[int]) -> list[float]:
    """The share of a core, in %, while nobody commands anything and the watchdog has stopped the legs."""
    time.sleep(TIMEOUT_MS / 1000)
    begun_ns, begun = time.monotonic_ns(), list(map(cpu_ns, pids))
    time.sleep(IDLE_S)
    took_ns = time.monotonic_ns() - begun_ns
    return [100 * (cpu_ns(pid) - before_ns) / took_ns for pid, before_ns in zip(pids, begun, strict=True)]


def main() -> None:
    """Compare them in each stream. A benchmark is no test: it fails for no figure."""
    if shutil.which("cc") is None:
        sys.exit("no C compiler: the device that answers at once cannot be built")
    cpu = next((line for line in Path("/proc/cpuinfo").read_text().splitlines() if "model name" in line), "")
    print(
        f"{os.cpu_count()} × {cpu.partition(': ')[2] or platform.machine()}, Linux {platform.release()}, "
        f"Python {platform.python_version()}, load {os.getloadavg()[0]:.1f}; the gateway's figures before the naive "
        "script's; ratios are medians over slices (least to most)",
        flush=True,
    )
    never_delay(os.getpid())  # the publisher is on another machine
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder) / "instant_spidev.so"
        subprocess.run(["cc", "-O2", "-shared", "-fPIC", "-o", str(library), str(_SOURCE), "-ldl"], check=True)
        for stream in STREAMS:
            compare(stream, Path(folder))


if __name__ == "__main__":
    main()
