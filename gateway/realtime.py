"""What the process can do for itself on a busy machine: be scheduled first, and never pause for long by its own doing.

Nothing here is needed to run, and each is tried alone: without the right to it (RLIMIT_RTPRIO, RLIMIT_NICE or root),
things stay as they were.
"""

import gc
import logging
import os
import sys
from contextlib import suppress
from typing import Final

LOOP_PRIORITY: Final = 20
"""The loop's: it holds the watchdog and writes to SPI. What the service unit allows at most."""
WAITER_PRIORITY: Final = 10
"""The threads' that wait for commands: a hundred lines of Python an item, and then they wait for the loop. They hold
the interpreter's lock meanwhile, so a loop with priority would wait for a waiter without."""
NICE: Final = -10
"""Zenoh's own threads: before the rest of the machine, but not so that a flood of messages starves it."""
SWITCH_INTERVAL_S: Final = 0.0005
"""For how long a thread (that of the metrics page, say) may keep the interpreter's lock from the loop; Python's own
5 ms would be half of what an emergency stop may take."""

logger = logging.getLogger(__name__)


def prefer_process() -> None:
    """Let this thread, and those that it starts from now on (Zenoh's), come before the rest of the machine."""
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    with suppress(PermissionError):
        if os.getpriority(os.PRIO_PROCESS, 0) > NICE:
            os.setpriority(os.PRIO_PROCESS, 0, NICE)


def prefer_thread(priority: int) -> bool:
    """Real-time priority for the calling thread alone, whether it was granted. Threads that it starts have none."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
    except (AttributeError, OSError):  # not Linux; not allowed
        return False
    return True


def settle() -> None:
    """Once everything stands: what lives now lives until the end, so no garbage collection needs to look at it again.

    A full collection took 30 ms before, and 0.2 ms after.
    """
    gc.collect()
    gc.freeze()
