"""`record`: everything that the gateway publishes, into an MCAP file, until somebody ends it."""

import time
from collections import Counter
from contextlib import suppress
from pathlib import Path
from queue import Empty
from typing import Any, Final

from gateway.errors import ConfigError, GatewayError
from gateway.geometry import load
from gateway.own_command import this_command
from gateway.people.client.live import ReportQueue
from gateway.people.recordings import REPORTS, Recording
from gateway.people.recordings.writing import about
from gateway.people.ros2 import cdr
from gateway.people.terminal import clear_line, hint, on_end_signals, say, show_line
from gateway.people.tools.reach import Connection
from schemas.keys import CALIBRATION, EVENT, FRAME, STATE

_PROGRESS_S: Final = 0.5
_SILENT_S: Final = 3.0
"""The progress reports a longer silence of the gateway."""
_MOST_WAITING: Final = 100_000
"""Reports that wait for the disk: minutes of frames. More are dropped and counted, before memory runs out."""

_NAMES: Final = {STATE: "states", EVENT: "events", FRAME: "frames"}


def record(connect: Connection, path: Path, *, geometry: Path | None, overwrite: bool, seconds: float | None) -> int:
    """Record until a signal, or for `seconds`. Returns the exit code."""
    cdr.require()
    shape = load(geometry)
    if path.exists() and not overwrite:
        raise ConfigError(f"{path}: exists; name another file, or overwrite it with --force")
    with connect() as client:
        state = client.state()
        try:
            recording = Recording(path, shape, overwrite=overwrite, time_ns=time.time_ns())
        except OSError as error:
            raise ConfigError(f"{path}: cannot be written ({error.strerror})") from error
        recording.describe(about(state))
        reports = ReportQueue(REPORTS, _MOST_WAITING, state.physics)
        if state.calibration.revision:  # so that the frames can be read; the default, and an older gateway, have 0
            reports.put(CALIBRATION, client.calibration().model_dump_json().encode())
        with reports.receives(client.session), on_end_signals(reports.end):
            if state.telemetry.frames is False:
                hint(
                    "The gateway publishes no frames, so the recording will have none, and nothing for `replay`: set "
                    "telemetry.frames = true in its settings and restart it, or go on without."
                )
            hint(f"recording into {path}; Ctrl-C ends it")
            return _Recorder(recording, reports, state.spi.frames).run(seconds)


class _Recorder:
    def __init__(self, recording: Recording, reports: ReportQueue, frames_before: int) -> None:
        self._recording = recording
        self._reports = reports
        self._begun_s = self._received_s = time.monotonic()
        self._counts: Counter[str] = Counter()
        self._frames_before = frames_before
        self._frames_written = 0

    def run(self, seconds: float | None) -> int:
        """Write until the end. Returns the exit code."""
        end_s = None if seconds is None else self._begun_s + seconds
        try:
            self._write_until(end_s)
            self._recording.close()
        except OSError as error:
            self._recording.abandon()
            clear_line()
            path = self._recording.path
            raise _DiskError(
                f"{path}: cannot be written any more ({error.strerror}). What came before is in it, and can be "
                f"read; once there is room, `{this_command()} recordings cut {path} FILE` makes a whole file of it"
            ) from error
        clear_line()
        self._report()
        return 0

    def _write_until(self, end_s: float | None) -> None:
        progress_s = self._begun_s
        while (now_s := time.monotonic()) < (end_s or now_s + 1):
            if now_s >= progress_s:
                progress_s = now_s + _PROGRESS_S
                self._show_progress()
            with suppress(Empty):
                received = self._reports.get(min(progress_s, end_s or progress_s) - now_s)
                if received is None:
                    return
                self._write(*received)

    def _write(self, key: str, report: dict[str, Any], time_ns: int) -> None:
        self._received_s = time.monotonic()
        self._counts[key] += 1
        if key == STATE:
            self._frames_written = report["spi"]["frames"]
        self._recording.add_report(key, report, time_ns)

    def _summary(self) -> str:
        counts = ", ".join(f"{self._counts[key]} {name}" for key, name in _NAMES.items())
        size_mb = self._recording.bytes_written / 1e6
        return f"{time.monotonic() - self._begun_s:.1f} s, {counts}, {size_mb:.1f} MB"

    def _show_progress(self) -> None:
        silent_s = time.monotonic() - self._received_s
        silence = f"nothing received for {silent_s:.0f} s; " if silent_s > _SILENT_S else ""
        show_line(f"{silence}{self._summary()}")

    def _report(self) -> None:
        say(f"{self._recording.path}: {self._summary()}")
        if (silent_s := time.monotonic() - self._received_s) > _SILENT_S:
            hint(f"Nothing was received from the gateway in the last {silent_s:.0f} s.")
        if not self._counts[FRAME] and self._frames_written > self._frames_before:
            hint("The gateway publishes no frames (telemetry.frames = false), so there is nothing for `replay`.")
        if self._reports.dropped:
            hint(f"{self._reports.dropped} reports are missing: the disk was too slow.")
        if self._reports.invalid:
            hint(f"{self._reports.invalid} messages on the gateway's keys were no reports, and are not in the file.")


class _DiskError(GatewayError):
    """The recording ends since the disk does not take it."""
