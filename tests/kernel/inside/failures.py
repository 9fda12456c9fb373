"""Transfers that fail at once, that Linux gives up on, or that stand still in the driver."""

import errno
import os
import signal
import time

from gateway.model.frames import Framing
from tests.kernel.inside import wire
from tests.kernel.inside.batches import BATCH, STOPS, bus, program
from tests.support.waiting import wait_until

GIVEN_UP_NS = 200_000_000
"""What Linux waits at least for a transfer that never ends."""
HANG_MS = 3000


def fails_at_once() -> str:
    """The third frame of six Stops fails with EIO."""
    with bus(Framing.PLAIN) as ours:
        wire.give(fail_in=3, fail_err=errno.EIO)
        report = ours.write(STOPS)
    assert report.fault is not None, "no fault"
    assert wire.messages()[0].status == -errno.EIO
    sent = {each.data for each in wire.passed()}
    assert sent == set(wire.STOPS), f"{len(sent)} of six Stops left"
    return f"{report.fault}; all six Stops left"


def lost() -> str:
    """The first transfer of six Stops never ends, as where an interrupt is lost."""
    with bus(Framing.PLAIN) as ours:
        wire.give(lose_in=1)
        begun_ns = time.monotonic_ns()
        report = ours.write(STOPS)
        took_ms = (time.monotonic_ns() - begun_ns) / 1e6
    assert report.fault is not None, "no fault"
    first = wire.messages()[0]
    assert first.status == -errno.ETIMEDOUT, f"Linux gave {first.status}"
    took_ns = first.unprepared_ns - first.transfers[0].begin_ns
    assert took_ns >= GIVEN_UP_NS, f"Linux gave up after {took_ns / 1e6:.0f} ms"
    sent = {each.data for each in wire.passed()}
    assert sent == set(wire.STOPS), f"{len(sent)} of six Stops left"
    return f"ETIMEDOUT after {took_ns / 1e6:.0f} ms; all six Stops had left after {took_ms:.0f} ms"


HUNG = """
import os, sys
device = os.open(sys.argv[1], os.O_RDWR)
sys.stdin.readline()
os.write(device, b"hangs")
"""


def hangs() -> str:
    """A program hangs in the driver and is killed; another one's Stops wait behind it."""
    with program(BATCH, os.getcwd()) as stopper, program(HUNG, wire.DEVICE) as hung:
        stopper.wait_for_output("opened", 120)
        wire.forget()
        wire.give(hang_in=1, hang_ms=HANG_MS)
        hung.tell("go")
        wait_until(lambda: any(each.kind == wire.BEGIN for each in wire.records()), "the transfer")
        hung.send_signal(signal.SIGKILL)
        stopper.tell("go")
        time.sleep(HANG_MS / 3000)
        alive, waits = hung.returncode is None, "written" not in stopper.stdout
        still = not wire.passed()
        hung.wait(60)
        stopper.wait_for_output("written", 60)
    assert still, "the transfer ended too soon to tell"
    assert alive, "SIGKILL ended a program within the driver"
    assert waits, "Stops did not wait"
    found = wire.passed()
    assert found[0].data == b"hangs"
    assert [each.data for each in found[1:]] == wire.STOPS, "the Stops did not follow"
    hung_ms = (found[0].end_ns - found[0].begin_ns) / 1e6
    assert found[1].begin_ns >= found[0].end_ns
    return f"killed, and there until the driver returned after {hung_ms:.0f} ms; six Stops waited for that, and left"
