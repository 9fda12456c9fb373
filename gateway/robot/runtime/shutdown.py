"""The end of the service: what causes it, the last Stops, and an exit in bounded time."""

import asyncio
import logging
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any, NoReturn

import zenoh

import gateway
from gateway.errors import GatewayError, SpiError
from gateway.host import logs
from gateway.host.worker import in_thread
from gateway.model.frames import STOP_REPEAT_MS, STOP_REPEATS
from gateway.robot.blackbox.recorder import Recorder
from gateway.robot.host.ownership import Ownership
from gateway.robot.runtime.conductor import Conductor
from gateway.robot.spi import Wire
from gateway.robot.spi.stop_all import stop_once
from schemas.robot import LEGS, SERVO_IDS

SHUTDOWN_S = 0.8
"""Time for the end: the second of docs/interface.md, Behaviour *End*, without the process's own exit."""
REPEATS_S = 0.3
"""The part of SHUTDOWN_S for repeats of the last Stops."""
LAST_WORDS_S = 0.1
"""Time after SHUTDOWN_S for the log."""
EXEC_S = 5.0
"""Limit for the kernel to execute the program again, which takes milliseconds."""

logger = logging.getLogger(__name__)


class ServiceEnd:
    """Ends the service on a signal or an unexpected exception.

    After an unexpected exception the state may be inconsistent. So the robot is stopped and the service ends; systemd
    restarts it.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop, owner: Ownership, recorder: Recorder) -> None:
        self.failure: str | None = None
        self.starts_anew = False
        """Whether the process restarts the service. After a failure it does not."""
        self.handed_over: dict[str, str] = {}
        """The environment variables for the program that this process executes next."""
        self.stopped = True
        """Whether each leg got its last Stop."""
        self.requested = asyncio.Event()
        """Set when the service has to end."""
        self._owner = owner
        self._recorder = recorder
        # Its terminal sends SIGQUIT at Ctrl-\, and SIGHUP when it is gone.
        for number in (signal.SIGTERM, signal.SIGINT, signal.SIGQUIT, signal.SIGHUP):
            if number is signal.SIGHUP and signal.getsignal(number) is signal.SIG_IGN:
                continue  # nohup
            loop.add_signal_handler(number, self.requested.set)
        for number in (signal.SIGTSTP, signal.SIGTTOU):
            signal.signal(number, signal.SIG_IGN)  # a gateway suspended by its terminal would stop no leg
        loop.set_exception_handler(self._failed)

    def because(self, failure: str) -> None:
        """End the service as failed. `failure` goes to the black box and stderr."""
        self.failure, self.starts_anew = self.failure or failure, False
        self.requested.set()  # first: the black box may be what fails
        with self._owner:
            self._recorder.mistake(failure)

    def begin_again(self) -> None:
        """End the service and restart it in the same process. Its files are read again."""
        self.starts_anew = self.failure is None
        self.requested.set()

    def leave(self) -> NoReturn:
        """Exit, or execute the gateway again in the same process, with the same arguments, which ends all its threads.

        This happens at once, since a thread in Zenoh keeps the interpreter from ending. systemd sees no end of a
        service that starts anew, so that takes only as long as Python's start.
        """
        if self.failure is not None:
            sys.stderr.write(f"hexapod-gateway: {self.failure}\n")
        logs.close(LAST_WORDS_S)
        if self.starts_anew:
            here = Path(gateway.__file__).parents[1]
            # A package's folder is a program, run without this machine's packages (deploy/debian/hexapod-gateway).
            program = ("-IS", str(here)) if (here / "__main__.py").exists() else ("-m", "gateway")
            os.environ.update(self.handed_over)
            command = (sys.executable, *program, *sys.argv[1:])
            # A program inherits its thread's scheduling class, and this thread cannot give up its own
            # (SCHED_RESET_ON_FORK).
            threading.Thread(target=os.execv, args=(sys.executable, command), daemon=True).start()
            threading.Event().wait(EXEC_S)
        failed = self.starts_anew or self.failure is not None
        os._exit(GatewayError.exit_code if failed else 0 if self.stopped else SpiError.exit_code)

    def _failed(self, _loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        error = context.get("exception")
        logger.critical("%s; stopping the robot", context["message"], exc_info=error)
        self.because(f"a mistake in the gateway ended it: {error or context['message']}")


async def stop_the_robot(conductor: Conductor) -> bool:
    """Stop all six legs, and repeat the Stops for REPEATS_S at most; then wait as long for the power board.

    If the conductor fails, the Stops are written directly to its bus. Return whether each leg got its Stop.
    """
    supply, asked_ns, deadline_s = conductor.supply, time.monotonic_ns(), time.monotonic() + REPEATS_S
    if supply is not None:
        supply.line.cut()  # a transfer that hangs may hold the state
    with conductor.owner:
        try:
            stopped = conductor.shut_down()
        except Exception:
            logger.exception("the orderly end failed; writing the Stops directly")
            stopped = False
        unstopped, how = (
            (set[int](), "all six legs got their Stop") if stopped else _last_attempt(conductor.bus, deadline_s)
        )
    if stopped:
        with suppress(TimeoutError):
            await asyncio.wait_for(conductor.done.wait(), REPEATS_S)
    if supply is not None:
        answered: asyncio.Future[float | None] = conductor.loop.create_future()
        with conductor.owner:
            supply.confirm(SERVO_IDS, asked_ns, answered.set_result)
        await asyncio.wait([answered], timeout=REPEATS_S)  # does not cancel it, unlike `wait_for`
        ms = answered.result() if answered.done() else None
        confirmed = "not confirmed" if ms is None else f"confirmed after {ms:.0f} ms"
        said = f"the power board has {confirmed} that their supply is off"
        logger.log(logging.WARNING if ms is None else logging.INFO, said)
        how = f"{how}; {said}"
    with conductor.owner:
        conductor.recorder.ended(how)
    return not unstopped


def _last_attempt(bus: Wire, deadline_s: float) -> tuple[set[int], str]:
    """Stop all six legs repeatedly: a transient fault, or a fault of one leg's frame, must not keep others moving.

    Return the legs without a Stop, and a sentence for the black box. This blocks the loop and owns the state: after an
    exception nothing else may write to the bus.
    """
    unstopped, rounds_left, opened = set(LEGS), 1 + STOP_REPEATS, True
    while True:
        stopped, fault = stop_once(bus, opened=opened)
        unstopped -= stopped
        opened = fault is None
        rounds_left -= opened
        if not rounds_left or time.monotonic() > deadline_s:
            break
        time.sleep(STOP_REPEAT_MS / 1000)
    how = "all six legs got their Stop at the last attempt"
    if unstopped:
        how = f"no Stop could be written to legs {', '.join(map(str, sorted(unstopped)))}: {fault}"
    logger.log(logging.CRITICAL if unstopped else logging.WARNING, how)
    return unstopped, how


async def close_within(timeout_s: float, closes: Iterable[Callable[[], None]]) -> None:
    """Call each of `closes` on a background thread. If they take longer than `timeout_s`, do not wait for them.

    A frozen peer can delay Zenoh's close by ten seconds. The servos are already stopped.
    """

    def run_close() -> None:
        for close in closes:
            with suppress(zenoh.ZError):
                close()

    closed, _ = await asyncio.wait([in_thread("close", run_close)], timeout=max(0.0, timeout_s))
    if not closed:
        logger.warning("a peer does not close its connection; ending without waiting for it")
