"""What the process can do for itself on a busy machine: be scheduled first, never pause for long by its own doing, and
not grow.

Nothing here is needed to run, and each is tried alone: without the right to it (RLIMIT_RTPRIO, RLIMIT_NICE or root),
things stay as they were. Measured on two cores with fifty clients, a flood, 100 questions a second and a spinning
process on each core; worst lateness of 25 watchdog stops, two runs each (tests/hil/load.py):

| variant                                                                     | ms           |
|-----------------------------------------------------------------------------|--------------|
| nothing                                                                     | 141 and 520  |
| nice -10 for the process                                                    | 215 and 565  |
| real-time priority for the loop                                             | 1.3 and 2.9  |
| and for the threads that wait for commands                                  | 0.9 and 2.5  |
| garbage collections forced every 100 ms, all that, without `freeze_gc`      | 537 and 1024 |
| garbage collections forced every 100 ms, all that                           | 1.2 and 1.8  |
| the metrics page asked for without a pause, its thread without priority     | 3.2 and 161  |
| the metrics page asked for without a pause, with Python's switch interval   | 80 and 187   |
| the metrics page asked for without a pause, all that                        | 1.8 and 2.8  |
"""

import ctypes
import gc
import logging
import os
import sys
from contextlib import suppress
from typing import Final

LOOP_PRIORITY: Final = 20
"""The loop's: it holds the watchdog and writes to SPI. What the service unit allows at most."""
RECEIVER_PRIORITY: Final = 10
"""The threads' that wait for commands: a hundred lines of Python an item, and then they wait for the loop. They hold
the interpreter's lock meanwhile, so a loop with priority would wait for a receiver without."""
PAGE_PRIORITY: Final = 1
"""The metrics page's and the log's: in nobody's way, but not to be preempted while they hold the interpreter's lock."""
NICE: Final = -10
"""Zenoh's own threads: before the rest of the machine, but not so that a flood of messages starves it."""
SWITCH_INTERVAL_S: Final = 0.0005
"""For how long a thread (that of the metrics page, say) may keep the interpreter's lock from the loop; Python's own
5 ms would be half of what an emergency stop may take."""

TIMER_SLACK_NS: Final = 1
"""By how much Linux may delay the timers of a thread without real-time priority, to bundle them (50 µs by default).

With that, a pause of 50 µs between two transfers took 104 µs at the median. With 1 ns it takes 53, for the same 4 µs of
CPU time. To wait for it in a loop would take 50, and keep the interpreter's lock all the while.
"""
_PR_SET_TIMERSLACK: Final = 29  # as linux/prctl.h has it

MALLOC_ARENAS: Final = 2
"""From which all threads allocate. glibc's own choice, up to eight a processor, keeps in one what another needs: with
mixed traffic at ten times the real rate, memory grew by 8.6 MB in an hour, with two by 1.5.
"""
_M_ARENA_MAX: Final = -8  # as glibc's malloc.h has it

logger = logging.getLogger(__name__)


def prefer_process() -> None:
    """Let this thread, and those that it starts (Zenoh's), go before the rest of the machine, and wake on time."""
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    with suppress(OSError, AttributeError):  # only Linux knows this
        ctypes.CDLL(None).prctl(_PR_SET_TIMERSLACK, TIMER_SLACK_NS, 0, 0, 0)
    with suppress(PermissionError):
        if os.getpriority(os.PRIO_PROCESS, 0) > NICE:
            os.setpriority(os.PRIO_PROCESS, 0, NICE)


def limit_malloc_arenas() -> None:
    """Before the first thread starts: all allocate from the same few heaps. Only glibc knows this."""
    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).mallopt(_M_ARENA_MAX, MALLOC_ARENAS)


def prefer_thread(priority: int) -> bool:
    """Real-time priority for the calling thread alone, whether it was granted. Threads that it starts have none."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
    except (AttributeError, OSError):  # not Linux; not allowed
        return False
    return True


def freeze_gc() -> None:
    """Once everything stands: what lives now lives until the end, so no garbage collection needs to look at it again.

    A full collection took 64 ms before, and less than 0.01 ms after (48 900 objects, most of them pydantic's).
    """
    gc.collect()
    gc.freeze()
