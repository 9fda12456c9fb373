"""What a message costs in Python calls, from Zenoh's ring to the kernel's `ioctl`: exactly, the same on every machine.

The messages are those that the shipped client sends. Each is in all its rings before the gateway's thread may take it,
so no look finds less than it was woken for. Calls of C functions count, too.
"""

import asyncio
import fcntl
import json
import sys
import threading
import time
import tracemalloc
from collections import Counter
from contextlib import ExitStack
from pathlib import Path
from types import FrameType
from typing import NamedTuple

import pytest
import zenoh

from gateway.people.client.payloads import leg_payload, legs_payload
from gateway.robot.blackbox.recorder import Recorder
from gateway.robot.core.events import Do, LeaseRequest
from gateway.robot.core.message import Received, Verb
from gateway.robot.core.supervisor import Supervisor
from gateway.robot.runtime.conductor import Conductor
from gateway.robot.service import rules
from gateway.robot.settings import Settings
from gateway.robot.spi.bus import Bus
from gateway.robot.spi.kernel import KernelDevice
from gateway.robot.zenoh_io.inbox import Inbox
from gateway.zenoh_config import scouting_off
from schemas import keys
from schemas.robot import LEGS

TOKEN = "0123456789abcdef" * 2
ROUNDS = 8
"""The least counts: on a machine that stood still meanwhile, the device's settings are looked at before a frame."""
LATE_S = 20.0
ANGLES = dict.fromkeys(LEGS, (91.25, 45.5, 120))


class Cost(NamedTuple):
    """Calls that a message takes."""

    to_ioctl: int
    in_all: int


class _Profile:
    """Counts what each thread calls that has it as its profiler, and notes when one waits for its next message."""

    def __init__(self) -> None:
        self.calls: Counter[str] = Counter()
        self.at_ioctl = 0
        """What the thread had called that wrote last, when it did."""
        self.waiting = {name: threading.Semaphore(0) for name in ("wakeup-put", "wakeup-get", "estop-put")}

    def __call__(self, frame: FrameType, event: str, argument: object) -> None:
        if event in ("call", "c_call"):
            name = threading.current_thread().name
            self.calls[name] += 1
            if event == "call" and frame.f_code is _ioctl.__code__:
                self.at_ioctl = self.calls[name]
            if event == "c_call" and getattr(argument, "__name__", "") == "recv" and name in self.waiting:
                self.waiting[name].release()


class _NoReports:
    """Takes reports, as the outbox does."""

    def publish(self, key: str, report: object) -> None:
        """Nobody listens."""


class _Gateway:
    """The parts of a gateway from Zenoh to a kernel's device."""

    def __init__(self, session: zenoh.Session, folder: Path, stack: ExitStack) -> None:
        sections = {"watchdog": {"timeout_ms": 10_000}, "spi": {"frame_gap_us": 0}, "limits": {"leg_rate_hz": 1000}}
        settings = Settings.model_validate({**sections, "state": {"path": str(folder)}})
        recorder = stack.enter_context(Recorder(settings, {}, time.monotonic_ns, time.time_ns))
        device = KernelDevice("/dev/null", settings.spi.speed_hz, exclusive=False)
        loop = asyncio.new_event_loop()
        self.session = session
        self.conductor = Conductor(
            settings,
            Supervisor(rules(settings)),
            Bus(settings.spi, lambda: device),
            _NoReports(),
            loop,
            clock=time.monotonic_ns,
            simulated=False,
            recorder=recorder,
        )
        self.conductor.start()
        self.conductor.announce_start()
        recorder.open()
        self.profile = _Profile()
        threading.setprofile(self.profile)  # of the threads that start now
        inbox = Inbox(
            session,
            loop,
            self.conductor.owner,
            on_wakeup=self.conductor.tick,
            on_estop=lambda received: self.conductor.tick((received,)),
            on_state_query=self.conductor.answer_state,
        )
        threading.setprofile(None)
        self.conductor.connect(inbox)
        stack.callback(loop.close)
        stack.callback(self.conductor.close)
        stack.callback(inbox.close)
        for waiting in self.profile.waiting.values():
            assert waiting.acquire(timeout=LATE_S)

    def least(self, key: str, payload: dict[str, object], thread: str = "wakeup-put") -> Cost:
        """How many calls one message takes to the `ioctl`, and in all."""
        return min(self.send(key, payload, thread) for _ in range(ROUNDS))

    def send(self, key: str, payload: dict[str, object], thread: str = "wakeup-put") -> Cost:
        """The same of one."""
        while time.monotonic_ns() < max(leg.slots.next_ns for leg in self.conductor.supervisor.legs):
            pass  # a rate slot of 1 ms
        before = self.profile.calls[thread]
        with self.conductor.owner:
            data = json.dumps({"source": "anna", **payload, "sent_ms": time.monotonic() * 1000})
            if thread == "wakeup-get":
                answers = self.session.get(key, payload=data, encoding="application/json")
            else:
                self.session.put(key, data, encoding="application/json", express=True)
        assert self.profile.waiting[thread].acquire(timeout=LATE_S)
        if thread == "wakeup-get":
            assert [json.loads(answer.ok.payload.to_bytes())["accepted"] for answer in answers if answer.ok] == [True]
        return Cost(self.profile.at_ioctl - before, self.profile.calls[thread] - before)

    def stop(self) -> Cost:
        """The same of an emergency stop, from the moment at which its thread owns the state."""
        stop = Received(
            keys.ESTOP, keys.ESTOP, keys.COMMAND_KEYS[keys.ESTOP], Verb.PUT, b"", 0, "", None, time.monotonic_ns()
        )
        with self.conductor.owner:
            sys.setprofile(self.profile)
            before = self.profile.calls["MainThread"]
            self.conductor.tick((stop,))
            sys.setprofile(None)
        return Cost(self.profile.at_ioctl - before, self.profile.calls["MainThread"] - before)


def _ioctl(_file: int, request: int, _argument: object) -> int:
    """The kernel's."""
    return _BYTES.get(request, 0)


_BYTES = {1 << 30 | frames * 32 << 16 | ord("k") << 8: 14 * frames for frames in range(1, 7)}
"""By SPI_IOC_MESSAGE(frames): how many bytes frames of a leg each have."""
STREAM, LEG_3 = legs_payload("set", ANGLES), leg_payload("set", ANGLES[3])


def costs(folder: Path) -> tuple[dict[str, Cost], int]:
    """Of each message, with a black box in `folder`; and the bytes of memory that a stream's takes at a time."""
    with ExitStack() as stack:
        patch = stack.enter_context(pytest.MonkeyPatch.context())
        patch.setenv("XDG_RUNTIME_DIR", str(folder))
        patch.setitem(sys.modules, "spidev", None)
        patch.setattr(fcntl, "ioctl", _ioctl)
        config = zenoh.Config()
        scouting_off(config)
        config.insert_json5("listen/endpoints", "[]")
        gateway = _Gateway(stack.enter_context(zenoh.open(config)), folder, stack)
        gateway.send(keys.LEGS_COMMAND, legs_payload("start", ANGLES))
        found = {
            "a stream's six legs": gateway.least(keys.LEGS_COMMAND, STREAM),
            "an acked leg": gateway.least(keys.leg_command(3), LEG_3, "wakeup-get"),
            "a leg": gateway.least(keys.leg_command(3), LEG_3),
        }
        tracemalloc.start()
        before, _ = tracemalloc.get_traced_memory()
        gateway.send(keys.LEGS_COMMAND, STREAM)
        _, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        with gateway.conductor.owner:
            gateway.conductor.ask(LeaseRequest(Do.ACQUIRE, "anna", fresh_token=TOKEN))
        found["a walk's six legs"] = gateway.least(keys.LEGS_COMMAND, {**STREAM, "lease": TOKEN})
        found["an emergency stop"] = min(gateway.stop() for _ in range(ROUNDS))
        return found, peak - before
