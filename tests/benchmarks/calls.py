"""What a setpoint costs in Python calls and in memory: the same on every machine, however busy.

    python -m tests.benchmarks.calls [SECONDS [FOLDER]]

FOLDER: with a black box there.

A gateway's parts in a process of their own, with the real Zenoh and a device that only takes bytes; a publisher in
another. Every Python and C function that a thread of the gateway's calls is counted, from the message in its ring to
the frame written, wake-ups that find nothing included.
"""

import asyncio
import json
import os
import selectors
import sys
import threading
import time
import tracemalloc
from contextlib import ExitStack, closing
from pathlib import Path
from statistics import median
from types import FrameType
from typing import Any

from gateway.robot.blackbox.recorder import Recorder
from gateway.robot.core.supervisor import Supervisor
from gateway.robot.edge.inbox import Inbox
from gateway.robot.edge.outbox import ZenohOutbox
from gateway.robot.edge.session import service_config
from gateway.robot.runtime.conductor import Conductor
from gateway.robot.service import rules
from gateway.robot.settings import Settings
from gateway.robot.spi import Batch
from gateway.robot.spi.bus import Bus
from gateway.robot.spi.simulator import SimulatedController
from gateway.zenoh_config import open_session
from tests.benchmarks.table import Row
from tests.support.child import Child
from tests.support.gateway_process import free_port

RUN_S = 4.0
HZ = 40
"""Below the rate limit, so that no setpoint waits for a rate slot and a timer."""
MOST_CALLS = 130
HELD_CALLS = 175
"""What a test holds them to. A message that is heard of before it is in its ring costs a second look, so that there are
some fifteen more on a machine that is busy."""


class _Device(SimulatedController):
    """Takes bytes, and notes how much memory was taken at a time since the last ones."""

    def __init__(self, settings: Settings) -> None:
        super().__init__(settings.spi.framing)
        self.taken: list[int] = []
        self._before = 0

    def transfer(self, batch: Batch) -> None:
        del batch
        if tracemalloc.is_tracing():
            now, peak = tracemalloc.get_traced_memory()
            self.taken.append(peak - self._before)
            tracemalloc.reset_peak()
            self._before = now


class _Counter:
    """Counts what the threads call that have it as their profiler."""

    def __init__(self) -> None:
        self.calls = 0

    def __call__(self, _frame: FrameType, event: str, _argument: object) -> None:
        self.calls += event in ("call", "c_call")


async def _measure(run_s: float, recorder: Recorder) -> tuple[float, float]:
    """Calls, and bytes, for a setpoint."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    settings = _settings({"zenoh": {"listen": [endpoint]}})
    loop, counter, device, outbox = asyncio.get_running_loop(), _Counter(), _Device(settings), ZenohOutbox()
    bus = Bus(settings.spi, lambda: device)
    conductor = Conductor(
        settings,
        Supervisor(rules(settings)),
        bus,
        outbox,
        loop,
        clock=time.monotonic_ns,
        simulated=True,
        recorder=recorder,
    )
    conductor.start()
    conductor.announce_start()
    recorder.open()
    session = open_session(service_config(settings.zenoh))
    outbox.open(session)
    threading.setprofile(counter)  # the inbox's threads, which start now
    with conductor.owner:
        inbox = Inbox(
            session,
            loop,
            conductor.owner,
            on_wakeup=conductor.tick,
            on_estop=lambda received: conductor.tick((received,)),
            on_state_query=conductor.answer_state,
        )
        conductor.connect(inbox)
    beat = asyncio.create_task(_beat(conductor))
    command = [sys.executable, "-m", "tests.benchmarks.publisher", endpoint, "--legs", "3", "--hz", str(HZ)]
    with ExitStack() as stack:
        publisher = stack.enter_context(closing(Child(command, os.environ)))
        await asyncio.to_thread(publisher.wait_for_output, "ready", 20)
        publisher.tell("0.5")  # whatever is slow only once
        await asyncio.to_thread(publisher.wait_for_line, 1)
        counter.calls, before = 0, conductor.metrics.accepted
        sys.setprofile(counter)
        publisher.tell(str(run_s))
        await asyncio.to_thread(publisher.wait_for_line, 2)
        sys.setprofile(None)
        calls_each = counter.calls / (conductor.metrics.accepted - before)
        tracemalloc.start()
        publisher.tell(str(run_s / 4))
        await asyncio.to_thread(publisher.wait_for_line, 3)
        tracemalloc.stop()
    beat.cancel()
    await asyncio.to_thread(inbox.close)
    conductor.close()
    await asyncio.to_thread(session.close)
    return calls_each, median(device.taken)


def _settings(sections: dict[str, Any]) -> Settings:
    quiet = {"watchdog": {"timeout_ms": 10_000, "repeats": 0}, "spi": {"frame_gap_us": 0}}
    return Settings.model_validate({**quiet, **sections})


async def _beat(conductor: Conductor) -> None:
    """As the service does: a loop that does not turn for long counts as stopped, and what came meanwhile as delayed."""
    while True:
        with conductor.owner:
            conductor.turned()
        await asyncio.sleep(0.1)


def main() -> None:
    """Print both as JSON."""
    run_s = float(sys.argv[1]) if len(sys.argv) > 1 else RUN_S
    settings = _settings({"recorder": {"path": "".join(sys.argv[2:])}})
    recorder = Recorder(settings, {}, time.monotonic_ns, time.time_ns)
    with asyncio.Runner(loop_factory=lambda: asyncio.SelectorEventLoop(selectors.SelectSelector())) as runner:
        calls_each, bytes_each = runner.run(_measure(run_s, recorder))
    print(json.dumps({"calls": calls_each, "bytes": bytes_each}), flush=True)


def measured(run_s: float = RUN_S, *folder: Path) -> dict[str, float]:
    """`calls` and `bytes` for a setpoint, from a process of their own; with a `folder`, the black box's as well."""
    command = [sys.executable, "-m", "tests.benchmarks.calls", str(run_s), *map(str, folder)]
    with closing(Child(command, os.environ)) as child:
        child.wait(60)
        found: dict[str, float] = json.loads(child.stdout)
        return found


def calls(folder: Path) -> list[Row]:
    """The figures."""
    found = measured()
    number = found["calls"]
    os.environ["XDG_RUNTIME_DIR"] = str(folder)  # for the ring, which goes with it
    return [
        Row("Python calls for a setpoint", f"{number:.0f}", "", f"at most {MOST_CALLS}", number <= MOST_CALLS),
        Row("Python calls for a setpoint, with the black box", f"{measured(RUN_S, folder)['calls']:.0f}", ""),
        Row("memory taken at a time for a setpoint", f"{found['bytes'] / 1024:.1f} kB", ""),
    ]


if __name__ == "__main__":
    main()
