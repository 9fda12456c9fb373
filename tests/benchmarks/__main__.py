"""What setpoints and idling cost: naive script and gateway run at once, and one publisher gives each a slice in turn.

Both write to a device that answers at once (instant_spidev.c). Within a second a machine changes its pace, and with it
all figures; the ratio of two slices that follow each other stays. Processor time is that of all threads (schedstat).
An earlier release, in a folder with its source, may run as a third. If `make .venv/rclpy` has installed rclpy, a bare
node of ROS 2 runs, too (`rclpy_pair.py`).

python -m tests.benchmarks [--quick] [--release FOLDER]
"""

import argparse
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
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from typing import Any, Final

import zenoh

from gateway.model.frames import Framing
from gateway.zenoh.config import client_config
from schemas.keys import LEGS_COMMAND, leg_command
from schemas.robot import LEGS
from tests.benchmarks.processes import cpu_ns, never_delay, say
from tests.support.bridged import clean
from tests.support.child import Child
from tests.support.gateway_process import COMMAND, READY, free_port, write_settings
from tests.support.rclpy_peer import DOMAIN, ENV, PYTHON, ROOT

NAIVE, GATEWAY, RELEASE, RCLPY = "naive", "gateway", "release", "rclpy"
SLICES, SLICE_S, HZ = 8, 1.0, 50
SENDER: Final = {"source": "publisher"}
TIMEOUT_MS, IDLE_S = 10_000, 5.0
_SOURCE: Final = Path(__file__).with_name("instant_spidev.c")
_PAIR: Final = "tests.benchmarks.rclpy_pair"
_NOTES_AT, _NOTE = 4096, struct.Struct("<QB15s8x")
_LEAST_CDEG, _ANGLES = 4_00, 176_00
"""A message's number is the angle of joint 1 in hundredths; `length-prefixed` sends none of 1 to 4 degrees."""


@dataclass(frozen=True, slots=True)
class Stream:
    name: str
    whole: bool = False
    """All legs in one message, as the client's stream sends them."""
    framing: Framing = Framing.PLAIN
    cpu_aim: float | None = None
    p50_aim: float | None = None
    rclpy_aim: float | None = None
    at_once: int = 1
    """How many messages follow each other without a pause."""


STREAMS: Final = (
    Stream("six legs, a message each", cpu_aim=2.3, p50_aim=1.8, rclpy_aim=1.0),
    Stream("legs/cmd", whole=True, cpu_aim=2.0, p50_aim=1.8),
    Stream("six legs, all at once", rclpy_aim=1.0, at_once=len(LEGS)),
    Stream("six legs, length-prefixed", framing=Framing.LENGTH_PREFIXED),
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


Row = tuple[str, ...]
"""A figure's name, the gateway's, the naive script's beside it, the aim, and whether it is met."""


def row(name: str, gateway: str, naive: str, found: float = 0, most: float | None = None, unit: str = "×") -> Row:
    """Return one row. `most`: the aim, or None without one."""
    aims = ("", "") if most is None else (f"at most {most}{unit}", "met" if found <= most else "NOT MET")
    return name, gateway, naive, *aims


def as_text(rows: list[Row]) -> str:
    cells = [("figure", "gateway", "naive script", "aim", ""), *rows]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    lines = ["  ".join(map(str.ljust, line, widths)).rstrip() for line in cells]
    return "\n".join([lines[0], "-" * len(lines[0]), *lines[1:]])


class Runner:
    """One of those that are compared, running on a device of its own."""

    def __init__(self, name: str, stream: Stream, folder: Path, stack: ExitStack, release: Path | None) -> None:
        self.name, self._stream, self._count, self.figures = name, stream, 0, Figures()
        endpoint, notes = f"tcp/127.0.0.1:{free_port()}", folder / "notes"
        env = {**os.environ, "LD_PRELOAD": str(folder.parent / "instant_spidev.so"), "NOTES": str(notes)}
        if name == NAIVE:
            command, ready = [sys.executable, "-m", "tests.benchmarks.naive", endpoint, stream.framing], "ready"
        else:
            settings: dict[str, dict[str, Any]] = {
                "zenoh": {"listen": [endpoint]},
                "spi": {"framing": stream.framing},
                "limits": {"leg_rate_hz": 250},
                "watchdog": {"timeout_ms": TIMEOUT_MS},
                "state": {"path": str(folder / "state")},
            }
            config = write_settings(folder / "gateway.toml", settings)
            command, ready = [*COMMAND, "run", "--config", str(config)], READY
        cwd = release if name == RELEASE else None
        child = Child(["env", *command], env, cwd)  # a fork of the tests' fork server would not load the library
        stack.callback(child.close)
        child.wait_for_output(ready, timeout_s=30)
        self.pid = child.pid
        file = stack.enter_context(notes.open("r+b"))
        self._notes = stack.enter_context(mmap.mmap(file.fileno(), 0))
        session = stack.enter_context(zenoh.open(client_config(endpoint)))
        keys = [LEGS_COMMAND] if stream.whole else [leg_command(leg) for leg in LEGS]
        self._publishers = [
            session.declare_publisher(
                key, encoding="application/json", congestion_control=zenoh.CongestionControl.DROP, express=True
            )
            for key in keys
        ]
        for leg in LEGS:
            session.put(leg_command(leg), json.dumps(_leg("start", 0) | SENDER), encoding="application/json")
            time.sleep(0.05)
        time.sleep(0.5)

    def slice(self, seconds: float, *, counts: bool) -> None:
        """Publish for that long, and note what it cost."""
        sent_ns: dict[int, int] = {}
        first, begun_ns, begun_cpu_ns = self._seen(), time.monotonic_ns(), cpu_ns(self.pid)
        period_s = 1 / HZ / len(self._publishers)
        messages = round(seconds / period_s)
        for number in range(messages):
            at_once = self._stream.at_once
            pause_s = begun_ns / 1e9 + number // at_once * at_once * period_s - time.monotonic()
            if pause_s > 0:
                time.sleep(pause_s)
            self._count += 1
            cdeg = _LEAST_CDEG + self._count % _ANGLES
            sent_ns[cdeg] = self._send(number % len(self._publishers), cdeg)
        time.sleep(0.05)
        took_ns, used_ns = time.monotonic_ns() - begun_ns, cpu_ns(self.pid) - begun_cpu_ns
        if not counts:
            return
        self.figures.cpu_us.append(used_ns / 1000 / messages)
        self.figures.core.append(100 * used_ns / took_ns)
        last = LEGS[-1] if self._stream.whole else None
        for at_ns, frame in self._notes_since(first):
            if len(frame) >= 14 and frame[3] == 3 and last in (None, frame[2] // 10):
                begun = sent_ns.pop(frame[4] * 100 + frame[5], None)
                if begun is not None:
                    self.figures.latency_us.append((at_ns - begun) / 1000)

    def _send(self, index: int, cdeg: int) -> int:
        """Send the next message, and return the time."""
        now = time.monotonic_ns()
        set_leg = _leg("set", cdeg)
        payload = {"legs": dict.fromkeys(map(str, LEGS), set_leg)} if self._stream.whole else set_leg
        self._publishers[index].put(json.dumps({**payload, **SENDER, "sent_ms": now / 1e6}))
        return now

    def _seen(self) -> int:
        return int.from_bytes(self._notes[:8], "little")

    def _notes_since(self, first: int) -> Iterator[tuple[int, bytes]]:
        most = (len(self._notes) - _NOTES_AT) // _NOTE.size
        for number in range(first, self._seen()):
            at_ns, length, data = _NOTE.unpack_from(self._notes, _NOTES_AT + number % most * _NOTE.size)
            yield at_ns, data[:length]


class RclpyRunner:
    """A bare node of rclpy and its publisher. Only what the node costs is measured."""

    name: Final = RCLPY

    def __init__(self, stream: Stream, folder: Path, stack: ExitStack) -> None:
        self.figures, traffic = Figures(), (str(DOMAIN), str(HZ), str(stream.at_once))
        env = {**clean(), **ENV, "PYTHONPATH": str(ROOT)}
        preload = {"LD_PRELOAD": str(folder.parent / "instant_spidev.so"), "NOTES": str(folder / "notes")}
        node, self._publisher = (
            stack.enter_context(Child(["env", PYTHON, "-m", _PAIR, role, *traffic], {**env, **more}))
            for role, more in (("node", preload), ("publisher", {}))
        )
        node.wait_for_output("ready", timeout_s=30)
        self._publisher.wait_for_output("ready", timeout_s=30)
        self._pid = node.pid

    def slice(self, seconds: float, *, counts: bool) -> None:
        """Publish for that long, and note what it cost."""
        begun_ns, begun_cpu_ns = time.monotonic_ns(), cpu_ns(self._pid)
        self._publisher.ask(str(seconds), 10 * seconds)
        time.sleep(0.05)
        took_ns, used_ns = time.monotonic_ns() - begun_ns, cpu_ns(self._pid) - begun_cpu_ns
        if counts:
            self.figures.cpu_us.append(used_ns / 1000 / round(seconds * HZ * len(LEGS)))
            self.figures.core.append(100 * used_ns / took_ns)


def _leg(op: str, cdeg: int) -> dict[str, Any]:
    """Return a leg's setpoint that carries a number in joint 1's angle."""
    return {"servos": [{"op": op, "angle_deg": each} for each in (cdeg / 100, 90, 90)]}


def duel(folder: Path, *, short: bool, release: Path | None) -> list[Row]:
    """Run all streams, each with all runners at once. Return one row for each figure of each stream."""
    if shutil.which("cc") is None:
        say("no C compiler: the device that answers at once cannot be built, so setpoints are not measured")
        return []
    library = folder / "instant_spidev.so"
    subprocess.run(["cc", "-O2", "-shared", "-fPIC", "-o", str(library), str(_SOURCE), "-ldl"], check=True)
    never_delay(os.getpid())  # the publisher is on another machine
    return [each for stream in STREAMS if stream.cpu_aim or not short for each in _compared(stream, folder, release)]


def _compared(stream: Stream, folder: Path, release: Path | None) -> list[Row]:
    with ExitStack() as stack:
        runners: list[Runner] = []
        peers: list[RclpyRunner] = []
        if stream.rclpy_aim and Path(PYTHON).exists():  # first: it takes long, and the watchdog stops idle legs
            peers.append(_rclpy(stream, folder, stack))
        for name in (NAIVE, GATEWAY, RELEASE) if release else (NAIVE, GATEWAY):
            own = folder / name
            shutil.rmtree(own, ignore_errors=True)
            own.mkdir()
            runners.append(Runner(name, stream, own, stack, release))
        all_of: list[Runner | RclpyRunner] = [*peers, *runners]
        for number in range(SLICES + 1):  # the first counts for nothing: what is slow only once
            say(f"{stream.name}: slice {number} of {SLICES}")
            for runner in random.sample(all_of, len(all_of)):
                runner.slice(SLICE_S, counts=number > 0)
        idle = _idle(*runners[:2]) if stream.cpu_aim and not stream.whole else []
    found = {runner.name: runner.figures for runner in all_of}
    return [*_rows(stream, found), *_rows_of_rclpy(stream, found), *_rows_of_release(stream, found), *idle]


def _rclpy(stream: Stream, folder: Path, stack: ExitStack) -> RclpyRunner:
    own = folder / RCLPY
    own.mkdir(exist_ok=True)
    return RclpyRunner(stream, own, stack)


def _idle(naive: Runner, ours: Runner) -> list[Row]:
    """Measure while nobody commands anything, and the watchdog has stopped the legs."""
    say(f"idle for {IDLE_S:g} s")
    time.sleep(TIMEOUT_MS / 1000)
    begun_ns, begun = time.monotonic_ns(), [cpu_ns(runner.pid) for runner in (ours, naive)]
    time.sleep(IDLE_S)
    took_ns = time.monotonic_ns() - begun_ns
    used = [cpu_ns(runner.pid) - before_ns for runner, before_ns in zip((ours, naive), begun, strict=True)]
    share, their_share = (100 * used_ns / took_ns for used_ns in used)
    return [row("idle: CPU, share of one core", f"{share:.2f} %", f"{their_share:.2f} %", share, 0.4, " %")]


def _rows(stream: Stream, found: dict[str, Figures]) -> Iterator[Row]:
    ours, naive = found[GATEWAY], found[NAIVE]
    ratios = [our / their for our, their in zip(ours.cpu_us, naive.cpu_us, strict=True)]
    times = median(ratios)
    yield row(
        f"{stream.name}: processor time a message; of a core",
        f"{median(ours.cpu_us):.0f} µs, {times:.2f}× ({min(ratios):.2f} to {max(ratios):.2f}); "
        f"{median(ours.core):.1f} %",
        f"{median(naive.cpu_us):.0f} µs; {median(naive.core):.1f} %",
        times,
        stream.cpu_aim,
    )
    times = ours.p50_us / naive.p50_us
    yield row(
        f"{stream.name}: publish → {'sixth ' if stream.whole else ''}frame, p50",
        f"{ours.p50_us:.0f} µs, {times:.2f}×",
        f"{naive.p50_us:.0f} µs",
        times,
        stream.p50_aim,
    )


def _rows_of_rclpy(stream: Stream, found: dict[str, Figures]) -> Iterator[Row]:
    if RCLPY in found:
        ours, node = found[GATEWAY], found[RCLPY]
        ratios = [our / their for our, their in zip(ours.cpu_us, node.cpu_us, strict=True)]
        yield row(
            f"{stream.name}: against a bare node of rclpy: processor time a message",
            f"{median(ours.cpu_us):.0f} µs, {median(ratios):.2f}× ({min(ratios):.2f} to {max(ratios):.2f})",
            f"(the node: {median(node.cpu_us):.0f} µs; {median(node.core):.1f} %)",
            median(ratios),
            stream.rclpy_aim,
        )


def _rows_of_release(stream: Stream, found: dict[str, Figures]) -> Iterator[Row]:
    if RELEASE in found:
        before, ours = found[RELEASE], found[GATEWAY]
        cpu = median(our / their for our, their in zip(ours.cpu_us, before.cpu_us, strict=True))
        yield row(
            f"{stream.name}: against the release: processor time, p50",
            f"{cpu:.2f}×, {ours.p50_us / before.p50_us:.2f}×",
            f"(the release: {median(before.cpu_us):.0f} µs, {before.p50_us:.0f} µs)",
        )


def machine() -> str:
    cpu = next(
        (line.partition(": ")[2] for line in Path("/proc/cpuinfo").read_text().splitlines() if "model name" in line),
        platform.machine(),
    )
    return (
        f"{os.cpu_count()} × {cpu}, Linux {platform.release()}, Python {platform.python_version()},"
        f" load before the run {os.getloadavg()[0]:.1f}"
    )


def main() -> int:
    """Compare them. The exit status is 0 whatever the figures, for a benchmark is no test."""
    parser = argparse.ArgumentParser(description="Measure the gateway beside a naive script.")
    parser.add_argument("--quick", action="store_true", help="only the two streams that matter most")
    parser.add_argument("--release", type=Path, metavar="FOLDER", help="compare with this tree's gateway, too")
    options = parser.parse_args()
    where, begun_s = machine(), time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        print(as_text(duel(Path(folder), short=options.quick, release=options.release)))
    print(
        f"\n{where}; the run took {time.monotonic() - begun_s:.0f} s;"
        " ratios are medians over the slices (least to most)"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
