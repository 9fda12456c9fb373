"""Keeps the emergency stop in the state directory for the next run: after its Stops, on a thread of its own.

`estop.json` exists while an emergency stop is engaged. `estop-last.json` has the number of the latest one that was
left. Numbers continue, so that a reset for an earlier run names no emergency stop of this one.
"""

import asyncio
import logging
import os
import secrets
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Annotated, Final, NamedTuple

from pydantic import AwareDatetime, BaseModel, ConfigDict, Field, ValidationError

from gateway.errors import ConfigError
from gateway.files import durable
from gateway.host.realtime import PAGE_PRIORITY, prefer_thread
from gateway.host.worker import in_thread
from gateway.robot.core.events import Announce, EstopKept
from gateway.robot.host.disk import StateFolder
from gateway.robot.host.ownership import OwnersTimer
from gateway.robot.runtime.conductor import Conductor
from schemas.keys import ESTOP
from schemas.words import Kind

ESTOP_FILE: Final = "estop.json"
LAST_FILE: Final = "estop-last.json"
MAX_BYTES: Final = 4096
"""A file has about 200; a larger one is rejected unread."""
MAX_NUMBER: Final = 2**52
"""A file with a number from here on is damaged: above twice as much, JavaScript's integers are not exact."""
_UNHEARD_OF: Final = 10**9
"""If the last number is not known, numbers continue a random step above this, so that no earlier reset names them."""

READ_S: Final = 2.0
"""How long the start waits for the disk. A disk answers within milliseconds, a worn card within a second."""
PAUSE_S: Final = 0.1
"""The pause between two writes that change only the number: a flood of requests must not wear out the card."""
SLOW_S: Final = 5.0
"""A longer write counts as hanging and is reported. It takes milliseconds, on a worn card a second."""
RETRY_S: Final = 1.0
"""The pause between attempts after a failed write: a full disk may have space again."""
HANGS_S: Final = 0.1
"""A step that takes longer may never end: systemd kills a gateway whose transfer hangs. A step takes some 2 ms."""
FLUSH_S: Final = 0.2
"""How long the end of the service waits for a write."""
KEPT_S: Final = 0.05
"""How long an answer waits for the disk. Most write within 20 ms; a client waits as long for a power board."""
MOST_WAITING: Final = 100
"""Answers that wait for the disk; further ones leave at once."""
HANDED_OVER: Final = "GATEWAY_HANDOVER_ESTOP"
"""The environment variable with the emergency stop, for the program that this process executes next."""
_LOOK: Final = "make sure that nobody is in danger, then reset it"

logger = logging.getLogger(__name__)


class KeptEstop(NamedTuple):
    number: int
    """Its number; 0: there was none."""
    engaged: bool = False
    source: str | None = None
    time: datetime | None = None
    fault: str | None = None
    """Why it is not known, and so counts as engaged."""


class EstopKeeper:
    """Reads the emergency stop that an earlier run left, and writes each change. Without a folder it keeps nothing.

    The owner of the state calls it. Its thread writes the latest state, so an older state never follows a newer one.
    """

    def __init__(
        self,
        conductor: Conductor,
        folder: StateFolder | None,
        loop: asyncio.AbstractEventLoop,
        handed_over: KeptEstop | None = None,
    ) -> None:
        """Begin to read, on another thread, so that the first Stops do not wait for the disk.

        `handed_over`: this process's own, from before it executed the program anew. It is newer than the disk's.
        """
        self._conductor = conductor
        self._folder = folder
        self._loop = loop
        self._found: asyncio.Future[KeptEstop] = loop.create_future()
        self._handed_over = handed_over
        self._left = KeptEstop(0)
        self._wanted: KeptEstop | None = None
        self._written: KeptEstop | None = None
        self._unknown: str | None = None
        """Why an earlier run's emergency stop is not known, until a reset. None: it is known."""
        self._fault: str | None = None
        self._wakes: SimpleQueue[bool] = SimpleQueue()
        """Wakes the thread. True: write without a pause."""
        self._received = threading.Event()
        """An emergency stop was received; its step may not have ended."""
        self._idle = threading.Event()
        """All is written, or an attempt failed."""
        self._idle.set()
        if folder is not None:
            late = partial(self._report, f"the disk has not answered for {SLOW_S:g} s")
            self._slow = OwnersTimer(loop, conductor.owner, late)
            self._waiting: list[tuple[int, Callable[[bool], None]]] = []
            self._late = OwnersTimer(loop, conductor.owner, partial(self._answer, late=True))
            conductor.executor.when_kept = self.when_kept
            thread = in_thread("keep estop", partial(self._keep, folder))
            thread.add_done_callback(asyncio.Future.result)  # a mistake ends the service

    # ---- the start

    async def known(self) -> None:
        """Report the earlier run's emergency stop to the supervisor, before any command. Takes READ_S at most."""
        conductor, found, handed_over = self._conductor, KeptEstop(0), self._handed_over
        if self._folder is not None:
            late = f"{self._folder.path}: the disk has not answered for {READ_S:g} s"
            read_in_time, _ = await asyncio.wait((self._found,), timeout=READ_S)
            found = self._found.result() if read_in_time else _unknown(late)
        elif handed_over is None:
            return
        with conductor.owner:
            self._left = left = handed_over or found
            if not conductor.supervisor.latch.number:  # else the source and the time are those of a newer one
                conductor.reports.estop = left.source
                conductor.reports.estop_since = left.time
            self._unknown = left.fault
            self._written = None if found.fault else found
            conductor.ask(EstopKept(left.number, left.engaged))
            if self._folder is not None:
                conductor.on_latch = self._changed
                if conductor.supervisor.latch.since_ns is not None or handed_over is not None:
                    self._changed()  # one of this run may have come before, by the power board's off button
            self._show()

    def announce_start(self) -> None:
        """Publish that an earlier run's emergency stop is engaged, or that it counts as engaged."""
        if self._folder is None:
            logger.info(
                "an emergency stop and the calibration are kept in memory only, until this process ends (state.path)"
            )
        left = self._left
        if self._unknown is not None:
            number = self._conductor.supervisor.latch.number
            what = f"emergency stop {number} is engaged, since it is not known what an earlier run has left"
            detail = f"{what} ({self._unknown}); {_LOOK}"
        elif left.engaged:
            since = "" if left.time is None else f" of {left.time.astimezone(UTC):%Y-%m-%d %H:%M:%S} UTC"
            by = "" if left.source is None else f", by {left.source}"
            detail = f"emergency stop {left.number}{since}{by} is still engaged; {_LOOK}"
        else:
            return
        self._conductor.reports.announce(Announce(Kind.ESTOP_KEPT, detail, key=ESTOP))

    # ---- what changes

    def _changed(self) -> None:
        """Have a new emergency stop (its Stops are written) or a reset written to the disk."""
        before, self._wanted = self._wanted, self._present
        if not self._wanted.engaged:
            self._unknown = None
            self._show()
        # mutants accepted (Step): any number
        at_once = self._wanted.engaged != (before or self._written or KeptEstop(0)).engaged
        if self._wanted != self._written and (at_once or self._idle.is_set()):
            self._idle.clear()
            self._slow.set_in(SLOW_S)
            self._wakes.put(at_once)

    @property
    def _present(self) -> KeptEstop:
        latch, reports = self._conductor.supervisor.latch, self._conductor.reports
        if latch.since_ns is None:
            return KeptEstop(latch.number)
        return KeptEstop(latch.number, True, reports.estop_source, reports.estop_since)

    def when_kept(self, number: int, then: Callable[[bool], None]) -> None:
        """Call `then` as owner: True once emergency stop `number` is on the disk, False if it is not within KEPT_S."""
        self._waiting.append((number, then))
        if not self._late.armed:
            self._late.set_in(KEPT_S)
        self._answer(late=len(self._waiting) > MOST_WAITING)

    def _answer(self, *, late: bool) -> None:
        """Answer those whose emergency stop is on the disk; if it is too `late` to wait, all."""
        written, waiting = self._written or KeptEstop(0), self._waiting
        self._waiting = [] if late else [each for each in waiting if each[0] > written.number]
        for number, then in waiting:
            if late or number <= written.number:
                then(written.engaged and number <= written.number)

    def received(self) -> None:
        """Keep an emergency stop that was just received even if its step hangs. For any thread; never waits."""
        if self._folder is not None and not self._received.is_set():  # so that a flood fills no queue
            self._received.set()
            self._wakes.put(False)

    def _keep(self, folder: StateFolder) -> None:
        """The thread: read what an earlier run left, then write each change, with a pause after each attempt."""
        prefer_thread(PAGE_PRIORITY)
        try:
            folder.own()
            found = read(folder.path)
        except ConfigError as error:
            found = _unknown(str(error))
        with suppress(RuntimeError):  # the loop is closed: the service has ended
            self._loop.call_soon_threadsafe(self._found.set_result, found)
        received = False
        while True:
            with suppress(Empty):
                self._wakes.get(timeout=HANGS_S if received else None)
            while (wanted := self._wanted) is not None and wanted != self._written:
                until_s = self._write(folder, wanted) + time.monotonic()
                with suppress(Empty):
                    while not self._wakes.get(timeout=max(0.0, until_s - time.monotonic())):
                        pass
            if received:
                self._write_unfinished(folder)
            if received := self._received.is_set():
                self._received.clear()

    def _write_unfinished(self, folder: StateFolder) -> None:
        """Write an emergency stop whose step hangs (which then holds the state), or was ended by a mistake."""
        latch, wanted, waits = self._conductor.supervisor.latch, self._wanted, bool(self._conductor.messages.estops)
        number = latch.number + waits
        known = wanted is not None and wanted.engaged and wanted.number >= number
        if not known and (waits or latch.since_ns is not None):
            with suppress(ConfigError):  # reported once the step has ended
                folder.own()
                write(folder.path, KeptEstop(number, True))

    def _write(self, folder: StateFolder, wanted: KeptEstop) -> float:
        """Write, and have its end reported. Return the pause before the next attempt in seconds."""
        fault = None
        try:
            folder.own()
            write(folder.path, wanted)
            self._written = wanted
        except ConfigError as error:
            fault = str(error)
        with suppress(RuntimeError):  # the loop is closed: the service has ended
            self._loop.call_soon_threadsafe(self._attempted, wanted, fault)
        return PAUSE_S if fault is None else RETRY_S

    def _attempted(self, wanted: KeptEstop, fault: str | None) -> None:
        """Take the end of a write, on the loop: the thread never waits for the state, which a transfer may hold."""
        with self._conductor.owner:
            if fault is not None or wanted == self._wanted:
                self._slow.cancel()
                self._idle.set()
            else:
                self._slow.set_in(SLOW_S)
            self._answer(late=fault is not None)
            self._report(fault)

    def _report(self, fault: str | None) -> None:
        """Publish why the emergency stop, or its end, is not kept. None: it is kept."""
        before, self._fault = self._fault, fault
        if self._conductor.closed or before == fault:
            return
        self._show()
        if before is None:
            engaged = self._present.engaged
            what = "the emergency stop" if engaged else "the end of the emergency stop"
            then = "may forget it" if engaged else "engages it again"
            detail = f"{what} is not kept, so a restart {then}: {fault}"
            self._conductor.reports.announce(Announce(Kind.ESTOP_NOT_KEPT, detail, key=ESTOP))
        self._conductor.reports.publish()

    def _show(self) -> None:
        self._conductor.reports.estop_fault = self._fault or self._unknown

    # ---- the end

    def flush(self) -> None:
        """Wait until all is written or an attempt has failed, FLUSH_S at most. The caller must not own the state."""
        self._wakes.put(True)
        self._idle.wait(FLUSH_S)
        if self._folder is not None:
            with self._conductor.owner:
                self._answer(late=True)

    def hand_over(self) -> dict[str, str]:
        """Return the emergency stop as an environment variable. The caller owns the state, which has ended."""
        return {} if self._conductor.supervisor.latch.unknown else {HANDED_OVER: _text(self._present)}


def take_over() -> KeptEstop | None:
    """Return the emergency stop from before this process executed the program anew, once; None: it did not."""
    text = os.environ.pop(HANDED_OVER, None)
    if text is None:
        return None
    try:
        found = _Content.model_validate_json(text)
    except ValidationError as error:
        return _unknown(f"{HANDED_OVER}: is damaged ({error.errors()[0]['msg']})")
    return KeptEstop(found.number, found.time is not None, found.source, found.time)


# ---- the files


class _Content(BaseModel):
    model_config = ConfigDict(extra="forbid")

    number: Annotated[int, Field(ge=0, lt=MAX_NUMBER, strict=True)]
    source: str | None = None
    time: AwareDatetime | None = None


def read(folder: Path) -> KeptEstop:
    """Return the emergency stop that an earlier run left in `folder`. Waits for the disk. Never raises.

    It counts as engaged if the files cannot be read, or the folder cannot be written: an earlier run may have failed to
    keep it.
    """
    last = 0  # mutants accepted (Step): without the folder any number will do
    try:
        os.listdir(folder)  # raises for a missing folder, whose missing files mean nothing
        try:
            left = _content(folder / LAST_FILE)
            last = 0 if left is None else left.number
        except ConfigError:  # a damaged number alone engages nothing
            last = _unknown("").number
        engaged = _content(folder / ESTOP_FILE)
        if engaged is not None:
            return KeptEstop(max(engaged.number, last), True, engaged.source, engaged.time)
        found = KeptEstop(last)
        write(folder, found)
    except OSError as error:
        return _unknown(f"{error.filename or folder}: {error.strerror or error}", last)
    except ConfigError as error:
        return _unknown(str(error), last)
    return found


def _content(path: Path) -> _Content | None:
    """Return the file's content, or None without a file. Raises OSError, or ConfigError if it is damaged."""
    try:
        data = durable.read(path, MAX_BYTES)
        return None if data is None else _Content.model_validate_json(data)
    except ValidationError as error:
        raise ConfigError(f"{path}: is damaged ({error.errors()[0]['msg']})") from error
    except ValueError as error:
        raise ConfigError(f"{path}: {error}") from error


def _unknown(fault: str, last: int = 0) -> KeptEstop:
    """Return an emergency stop that counts as engaged, with a number that no reset can name yet."""
    number = last + _UNHEARD_OF + secrets.randbelow(_UNHEARD_OF)
    return KeptEstop(number, True, time=datetime.now(UTC), fault=fault)


def _text(kept: KeptEstop) -> str:
    """Return it as JSON; only an engaged one has a source and a time."""
    if not kept.engaged:
        return f'{{"number":{kept.number}}}'
    source = None if kept.source is None else kept.source.encode(errors="replace").decode()
    time = kept.time or datetime.now(UTC)
    return _Content.model_construct(number=kept.number, source=source, time=time).model_dump_json()


def write(folder: Path, kept: KeptEstop) -> None:
    """Write atomically; it is on the disk when this returns. Raises ConfigError if it cannot be written."""
    try:
        if kept.engaged:
            data = _text(kept).encode()
            # First without a sync, which a kill may interrupt. A part of a file counts as engaged, too.
            with suppress(FileExistsError), (folder / ESTOP_FILE).open("xb") as file:
                file.write(data)
            durable.write(folder / ESTOP_FILE, data)
        else:  # the number first: after a crash between the two, the emergency stop is engaged
            durable.write(folder / LAST_FILE, _text(kept).encode())
            (folder / ESTOP_FILE).unlink(missing_ok=True)
            durable.sync(folder)
    except OSError as error:
        raise ConfigError(f"{folder}: cannot be written ({error.strerror or error})") from error
