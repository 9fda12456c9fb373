"""Priorities, garbage collection and memory settings that keep Stops on time on a busy machine.

Each is optional, and changes nothing without its permission (RLIMIT_RTPRIO, RLIMIT_NICE or root). Measured on two cores
with fifty clients, a flood, 100 queries a second and a spinning process on each core: worst lateness of 25 watchdog
Stops, two runs each (tests/hil/test_load.py):

| variant                                                                     | ms           |
|-----------------------------------------------------------------------------|--------------|
| nothing                                                                     | 141 and 520  |
| nice -10 for the process                                                    | 215 and 565  |
| real-time priority for the loop                                             | 1.3 and 2.9  |
| and for the receiver threads                                                | 0.9 and 2.5  |
| forced garbage collections every 100 ms, all of this but `freeze_gc`        | 537 and 1024 |
| forced garbage collections every 100 ms, all of this                        | 1.2 and 1.8  |
| metrics page fetched without a pause, its thread without priority           | 3.2 and 161  |
| metrics page fetched without a pause, with Python's switch interval         | 80 and 187   |
| metrics page fetched without a pause, all of this                           | 1.8 and 2.8  |
"""

import ctypes
import gc
import os
import sys
from contextlib import suppress
from pathlib import Path
from typing import Final

LOOP_PRIORITY: Final = 20
"""Priority of the loop, which runs the watchdog, and the emergency stop's threads: the service unit's maximum."""
RECEIVER_PRIORITY: Final = 10
"""For the other receiver threads. They own the state or hold the interpreter's lock while they write frames; preempted
then, they would delay a Stop."""
PAGE_PRIORITY: Final = 1
"""Priority of the metrics page and the log: low, but not preempted while they hold the interpreter's lock."""
ZENOH_NICE: Final = -10
"""Niceness of Zenoh's own threads: ahead of other programs, but a flood does not starve those."""
SWITCH_INTERVAL_S: Final = 0.0005
"""How long another thread may hold the interpreter's lock while the loop waits. Python's default of 5 ms is half of an
emergency stop's allowed time."""

TIMER_SLACK_NS: Final = 1
"""How much Linux may delay the timers of a thread without real-time priority, to bundle them (default: 50 µs).

By default, a pause of 50 µs between two transfers took 104 µs in the median; with 1 ns it takes 53, for the same 4 µs
of CPU time. Busy waiting would take 50, and hold the interpreter's lock.
"""
_PR_SET_TIMERSLACK: Final = 29  # as linux/prctl.h has it

MALLOC_ARENAS: Final = 2
"""glibc's default is up to eight for each processor; free memory of one cannot be used by another. With mixed traffic
at ten times the real rate, memory grew by 8.6 MB in an hour by default, and by 1.5 MB with two."""
_M_ARENA_MAX: Final = -8  # as glibc's malloc.h has it


def prefer_process() -> None:
    """Schedule this thread and the threads that it starts (Zenoh's) ahead of other programs, with precise timers."""
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    with suppress(OSError, AttributeError):  # Linux only
        ctypes.CDLL(None).prctl(_PR_SET_TIMERSLACK, TIMER_SLACK_NS, 0, 0, 0)
    with suppress(PermissionError):
        if os.getpriority(os.PRIO_PROCESS, 0) > ZENOH_NICE:
            os.setpriority(os.PRIO_PROCESS, 0, ZENOH_NICE)
    # If Linux schedules sessions as groups (autogroup), nice counts only within a session. A service leads its own; a
    # terminal's session has other programs. Without such groups the file is missing.
    if os.getsid(0) == os.getpid():
        with suppress(OSError):
            Path("/proc/self/autogroup").write_text(str(ZENOH_NICE))


def limit_malloc_arenas() -> None:
    """Make all threads allocate from MALLOC_ARENAS arenas. Call it before the first thread starts. Needs glibc."""
    with suppress(OSError, AttributeError, TypeError):  # CDLL(None) fails on Windows
        ctypes.CDLL(None).mallopt(_M_ARENA_MAX, MALLOC_ARENAS)


def prefer_thread(priority: int) -> bool:
    """Give the calling thread, but not threads that it starts, real-time priority. Return whether it was granted."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
    except (AttributeError, OSError):  # not Linux; not allowed
        return False
    return True


def freeze_gc() -> None:
    """Exempt all present objects from garbage collection. Call it once, after the service is built.

    A full collection took 64 ms without this, and less than 0.01 ms with it (48 900 objects, most of them pydantic's).
    """
    gc.collect()
    gc.freeze()
