"""`record`: everything that the gateway says, into an MCAP file, until somebody ends it."""

import json
import shutil
import sys
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any, Final

import zenoh
from pydantic import ValidationError

from gateway.errors import ConfigError, GatewayError
from gateway.geometry import load
from gateway.people.client.blocking import Client
from gateway.people.recordings import REPORTS, Recording, is_cut_off, is_damaged, is_ours
from gateway.people.recordings import repair as repair_recording
from gateway.people.tools.reach import Connection
from gateway.people.tools.signals import on_end_signals
from gateway.people.tools.terminal import hint, say, this_command
from schemas.keys import CALIBRATION, EVENT, FRAME, STATE

PROGRESS_S: Final = 0.5
SILENT_S: Final = 3.0
"""Without a word from the gateway for so long, the progress says so."""
MOST_WAITING: Final = 100_000
"""Reports that wait for the disk: minutes of frames. More are dropped and counted, before memory runs out."""

_NAMES: Final = {STATE: "states", EVENT: "events", FRAME: "frames"}

Heard = tuple[str, bytes, int]
"""Key, payload, and when it came."""


def repair_file(path: Path) -> int:
    """`record --repair`."""
    if not path.exists():
        raise ConfigError(f"{path}: there is no such file")
    if is_cut_off(path) or is_damaged(path):
        _repair(path)
    else:
        say(f"{path}: is whole (or is being written just now); nothing to repair")
    return 0


def record(connect: Connection, path: Path, *, geometry: Path | None, overwrite: bool, seconds: float | None) -> int:
    """Record until a signal, or for `seconds`. Returns the exit code."""
    shape = load(geometry)
    _repair_all(path)
    if path.exists() and not overwrite:
        raise ConfigError(f"{path}: exists; name another file, or overwrite it with --force")
    with connect() as client:
        state = client.state()
        try:
            recording = Recording(path, shape, overwrite=overwrite, time_ns=time.time_ns())
        except OSError as error:
            raise ConfigError(f"{path}: cannot be written ({error.strerror})") from error
        recorder = _Recorder(recording, state.spi.frames)
        if state.calibration.revision:  # so that the frames can be read; the default, and an older gateway, have 0
            recorder.hear(CALIBRATION, client.calibration().model_dump_json().encode())
        with recorder.hears(client), on_end_signals(recorder.end):
            if state.telemetry.frames is False:
                hint(
                    "The gateway publishes no frames, so the recording will have none, and nothing for `replay`: set "
                    "telemetry.frames = true in its settings and restart it, or go on without."
                )
            hint(f"recording into {path}; Ctrl-C ends it")
            return recorder.run(seconds)


class _Recorder:
    """Zenoh's threads put what they hear into a queue; the calling thread writes it."""

    def __init__(self, recording: Recording, frames_before: int) -> None:
        self._recording = recording
        self._waiting: SimpleQueue[Heard | None] = SimpleQueue()
        self._begun_s = time.monotonic()
        self._since_1970_ns = time.time_ns() - time.monotonic_ns()
        self._heard_s = self._begun_s
        self._counts: Counter[str] = Counter()
        self._unread = 0
        self._dropped = 0
        self._frames_before = frames_before
        self._frames_written = 0

    @contextmanager
    def hears(self, client: Client) -> Iterator[None]:
        """What the gateway publishes meanwhile is heard."""
        subscribers = [client.session.declare_subscriber(key, partial(self._take, key)) for key in REPORTS]
        try:
            yield
        finally:
            for subscriber in subscribers:
                with suppress(zenoh.ZError):
                    subscriber.undeclare()

    def end(self) -> None:
        """End the recording; also from a signal handler."""
        self._waiting.put(None)

    def run(self, seconds: float | None) -> int:
        """Write until the end. Returns the exit code."""
        end_s = None if seconds is None else self._begun_s + seconds
        try:
            self._write_until(end_s)
            self._recording.close()
        except OSError as error:
            self._recording.abandon()
            _clear_progress()
            path = self._recording.path
            raise _DiskError(
                f"{path}: cannot be written any more ({error.strerror}). What came before is in it: make room, and "
                f"`{this_command()} record --repair {path}` makes it whole"
            ) from error
        _clear_progress()
        self._tell()
        return 0

    def _write_until(self, end_s: float | None) -> None:
        progress_s = self._begun_s
        while (now_s := time.monotonic()) < (end_s or now_s + 1):
            if now_s >= progress_s:
                progress_s = now_s + PROGRESS_S
                self._show_progress()
            with suppress(Empty):
                heard = self._waiting.get(timeout=min(progress_s, end_s or progress_s) - now_s)
                if heard is None:
                    return
                self._write(*heard)

    def hear(self, key: str, payload: bytes) -> None:
        """Something that the gateway says."""
        if self._waiting.qsize() >= MOST_WAITING:
            self._dropped += 1
            return
        self._waiting.put((key, payload, time.monotonic_ns() + self._since_1970_ns))

    def _take(self, key: str, sample: zenoh.Sample) -> None:
        self.hear(key, sample.payload.to_bytes())

    def _write(self, key: str, payload: bytes, time_ns: int) -> None:
        try:
            REPORTS[key].model_validate_json(payload)
        except ValidationError:  # without access control, anybody may publish there
            self._unread += 1
            return
        report: dict[str, Any] = json.loads(payload)
        self._heard_s = time.monotonic()
        self._counts[key] += 1
        if key == STATE:
            self._frames_written = report["spi"]["frames"]
        self._recording.add_report(key, report, time_ns)

    def _summary(self) -> str:
        counts = ", ".join(f"{self._counts[key]} {name}" for key, name in _NAMES.items())
        size_mb = self._recording.bytes_written / 1e6
        return f"{time.monotonic() - self._begun_s:.1f} s, {counts}, {size_mb:.1f} MB"

    def _show_progress(self) -> None:
        silent_s = time.monotonic() - self._heard_s
        silence = f"nothing heard for {silent_s:.0f} s; " if silent_s > SILENT_S else ""
        if sys.stderr.isatty():
            columns = shutil.get_terminal_size().columns  # a line that wraps would be written below itself each time
            sys.stderr.write(f"\r\x1b[K{f'{silence}{self._summary()}'[: columns - 1]}")
            sys.stderr.flush()

    def _tell(self) -> None:
        say(f"{self._recording.path}: {self._summary()}")
        if (silent_s := time.monotonic() - self._heard_s) > SILENT_S:
            hint(f"Nothing was heard of the gateway in the last {silent_s:.0f} s.")
        if not self._counts[FRAME] and self._frames_written > self._frames_before:
            hint("The gateway publishes no frames (telemetry.frames = false), so there is nothing for `replay`.")
        if self._dropped:
            hint(f"{self._dropped} reports are missing: the disk was too slow.")
        if self._unread:
            hint(f"{self._unread} messages on the gateway's keys were no reports, and are not in the file.")


class _DiskError(GatewayError):
    """The recording ends since the disk does not take it."""


def _clear_progress() -> None:
    if sys.stderr.isatty():
        sys.stderr.write("\r\x1b[K")
        sys.stderr.flush()


def _repair_all(path: Path) -> None:
    """Make whole what an earlier recording in this folder left behind when it was killed."""
    with suppress(OSError):
        for each in sorted(path.absolute().parent.glob("*.mcap")):
            if is_cut_off(each) and is_ours(each):
                try:
                    _repair(each)
                except (GatewayError, OSError) as error:  # what cannot be repaired keeps nobody from recording
                    hint(str(error))


def _repair(path: Path) -> None:
    was = "was cut off" if is_cut_off(path) else "was damaged"
    try:
        repaired = repair_recording(path)
    except OSError as error:
        raise _DiskError(f"{path}: cannot be repaired ({error.strerror}); it is as it was") from error
    say(f"{path}: {was}; repaired, with {repaired.messages} messages of {repaired.seconds:.1f} s")
    if repaired.original is not None:
        say(f"{path}: {repaired.losses}. As it was, the file is {repaired.original}")
