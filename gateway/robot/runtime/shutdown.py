"""The end of the service: what asks for it, the last Stops, and a process that goes in time."""

import asyncio
import logging
import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any, NoReturn

import zenoh

from gateway.errors import GatewayError
from gateway.host import logs
from gateway.robot.blackbox.recorder import Recorder
from gateway.robot.host.ownership import Ownership
from gateway.robot.runtime.conductor import Conductor
from gateway.robot.settings import WatchdogSettings
from gateway.robot.spi.bus import Bus
from gateway.robot.spi.stop_all import MOST_PAUSE_MS, stop_once
from schemas.robot import LEGS

END_S = 0.8
"""What the end may take: the second of docs/interface.md, Behaviour 7, less what the process needs to go."""
REPEATS_S = 0.3
"""Of that, what the repeats of the last Stops may take."""

LAST_WORDS_S = 0.1
"""Beyond that, what the log may take where nothing else waits for the end."""

EXEC_S = 5.0
"""How long the kernel may take to replace the program; it takes milliseconds."""

logger = logging.getLogger(__name__)


class End:
    """What ends the service: a signal, or a mistake of our own.

    After an exception that nobody expected, nobody knows what state is left; so the robot is stopped and the service
    ends, to be started afresh by systemd.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop, owner: Ownership, recorder: Recorder) -> None:
        self.failure: str | None = None
        self._starts_anew = False
        self._owner = owner
        self._recorder = recorder
        self._event = asyncio.Event()
        for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
            if number is signal.SIGHUP and signal.getsignal(number) is signal.SIG_IGN:
                continue  # nohup
            loop.add_signal_handler(number, self._event.set)  # SIGHUP: its terminal, or the link to it, is gone
        for number in (signal.SIGTSTP, signal.SIGTTOU):
            signal.signal(number, signal.SIG_IGN)  # a gateway that its terminal suspends would stop no leg
        loop.set_exception_handler(self._failed)

    async def wait(self) -> None:
        """Until something ends it."""
        await self._event.wait()

    def because(self, failure: str) -> None:
        """End, and report `failure`."""
        with self._owner:
            self._recorder.mistake(failure)
        self.failure = self.failure or failure
        self._event.set()

    def begin_again(self) -> None:
        """End, and start anew in the same process, with the configuration as it is then."""
        self._starts_anew = True
        self._event.set()

    @property
    def starts_anew(self) -> bool:
        """Whether the process goes on with a service that starts anew, and nothing has failed."""
        return self._starts_anew and self.failure is None

    def leave(self) -> NoReturn:
        """Leave the process, or let it start anew."""
        if self.starts_anew:
            start_anew()
        if self.failure is None:
            leave(0)
        sys.stderr.write(f"hexapod-gateway: {self.failure}\n")
        leave(GatewayError.exit_code)

    def task_done(self, task: "asyncio.Task[None]") -> None:
        """A task of the service may be cancelled, but must not fail."""
        if not task.cancelled() and task.exception() is not None:
            self._failed(task.get_loop(), {"message": "a task failed", "exception": task.exception()})

    def _failed(self, _loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        error = context.get("exception")
        logger.critical("%s; stopping the robot", context["message"], exc_info=error)
        self.because(f"a mistake in the gateway ended it: {error or context['message']}")


async def stop_the_robot(conductor: Conductor, bus: Bus, watchdog: WatchdogSettings) -> None:
    """Stop all six legs and repeat it for REPEATS_S at most; past the conductor where that did not write all six."""
    deadline = asyncio.get_running_loop().time() + REPEATS_S
    with conductor.owner:
        try:
            stopped = conductor.shut_down()
        except Exception:
            logger.exception("the orderly end failed; writing the Stops past it")
            stopped = False
        if not stopped:
            _last_attempt(bus, watchdog, deadline)
    if stopped:
        with suppress(TimeoutError):
            await asyncio.wait_for(conductor.done.wait(), REPEATS_S)
    with conductor.owner:
        how = "all six legs got their Stop" if stopped else "the Stops were written at a last attempt"
        conductor.recorder.ended(how)


def _last_attempt(bus: Bus, watchdog: WatchdogSettings, deadline: float) -> None:
    """All six legs again and again: a fault of a moment, or of one leg's frame, must not leave the others moving.

    It keeps the state, and the loop: nobody knows what else would be done, and these Stops are the last to be written.
    """
    unstopped, rounds_left, opened = set(LEGS), 1 + watchdog.repeats, True
    while True:
        stopped, fault = stop_once(bus, opened=opened)
        unstopped -= stopped
        opened = fault is None
        rounds_left -= opened
        if not rounds_left or time.monotonic() > deadline:
            break
        time.sleep(min(watchdog.repeat_interval_ms, MOST_PAUSE_MS) / 1000)
    if unstopped:
        logger.critical("no Stop could be written to legs %s: %s", ", ".join(map(str, sorted(unstopped))), fault)
    else:
        logger.warning("all six legs got their Stop at the last attempt")


async def close_within(timeout_s: float, leave: Callable[[], NoReturn], *closes: Callable[[], object]) -> None:
    """Close in a thread that nobody has to wait for: a frozen peer can hold Zenoh's close for ten seconds.

    The servos are safe by then, so after `timeout_s` the process goes without it, by `leave`.
    """
    closed = asyncio.Event()
    loop = asyncio.get_running_loop()

    def run_close() -> None:
        for close in closes:
            with suppress(zenoh.ZError):
                close()
        with suppress(RuntimeError):
            loop.call_soon_threadsafe(closed.set)

    threading.Thread(target=run_close, name="close", daemon=True).start()
    try:
        await asyncio.wait_for(closed.wait(), max(0.0, timeout_s))
    except TimeoutError:
        logger.warning("a peer does not let go of its connection; ending without waiting for it")
        leave()


def leave(exit_code: int) -> NoReturn:
    """End at once: a thread inside Zenoh would keep the interpreter from ending."""
    logs.close(LAST_WORDS_S)
    os._exit(exit_code)


def start_anew() -> NoReturn:
    """Replace this program by itself, as it was called, in the same process: every thread of it ends, whatever it does.

    So systemd sees no end, and waits for none of what it does between two starts: the service is back after what Python
    takes to start. On a thread of its own, since the new program has the scheduling class of the thread that calls
    this, and ours may not give up its own (SCHED_RESET_ON_FORK).
    """
    logs.close(LAST_WORDS_S)
    threading.Thread(target=os.execv, args=(sys.executable, sys.orig_argv), daemon=True).start()
    threading.Event().wait(EXEC_S)
    os._exit(GatewayError.exit_code)
