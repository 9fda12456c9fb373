"""`record`: everything that the gateway publishes, into a file and to viewers, until somebody ends it.

One context of the Foxglove SDK has an MCAP file and a live server as its sinks. Reports are logged as published.
"""

import asyncio
import csv
import json
import threading
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any, Final, TextIO

import zenoh
from pydantic import BaseModel, ValidationError

from gateway import __version__
from gateway.errors import AddressTakenError, ConfigError, GatewayError
from gateway.geometry import Geometry, load
from gateway.people.client.subscriptions import States
from gateway.people.commands.reach import Connection
from gateway.people.recorder import RecordOptions
from gateway.people.recorder.drawing import CAMERAS, DESCRIPTION, DRAWN, LOG, Drawing, definition, encode, log_line
from gateway.people.ros2.messages import LOG_WARN, CompressedImage, Message
from gateway.people.terminal import clear_line, hint, on_end_signals, say, show_line
from gateway.people.watching.live import is_of_physics
from gateway.words.own_command import install
from schemas.calibration import Calibration
from schemas.config import ConfigReport
from schemas.event import Event, FrameRecord
from schemas.gateway_state import GatewayState
from schemas.keys import CALIBRATION, CONFIG, EVENT, FRAME, SIM_BODY, STATE, TELEMETRY
from schemas.robot import SERVO_IDS
from schemas.simulation import BodyReport
from schemas.telemetry import Telemetry

try:
    import foxglove
    import rosbags  # noqa: F401  # `drawing` can be imported without
    from foxglove.mcap import MCAPWriteOptions
    from foxglove.websocket import ChannelView, ServerListener
    from foxglove.websocket import Client as Viewer

    from gateway.people.watching import camera as watching
except ImportError as error:
    raise ConfigError(f"to record, type: {install('record')}") from error

HOST: Final = "127.0.0.1"
"""Viewers on this machine only. From elsewhere, `ssh -L` leads here."""
METADATA: Final = "hexapod-gateway"
LARGEST_CHUNK: Final = 4 << 20
"""In bytes, uncompressed: six legs at 50 Hz fill less in FLUSH_S."""

REPORTS: Final[Mapping[str, type[BaseModel]]] = {
    STATE: GatewayState,
    CONFIG: ConfigReport,
    EVENT: Event,
    FRAME: FrameRecord,
    CALIBRATION: Calibration,
    TELEMETRY: Telemetry,
    SIM_BODY: BodyReport,
}
"""The keys that are recorded, which are their channels' names, and what is recorded: each state with its
configuration."""


class Recording(ServerListener):
    """Logs to the sinks that were opened. Times are nanoseconds since 1970."""

    def __init__(self, geometry: Geometry, camera_names: Iterable[str] = ()) -> None:
        self.drawing = Drawing(geometry)
        self._context = foxglove.Context()
        # `foxglove.Channel` gives JSON a schema, and rosbags 0.11 opens no file that has one.
        create = self._context._create_channel
        self._channels = {key: create(key, message_encoding="json") for key in REPORTS}
        for topic, kind in (*DRAWN.items(), *((f"{CAMERAS}{each}", CompressedImage) for each in camera_names)):
            schema = foxglove.Schema(name=kind.TYPE, encoding="ros2msg", data=definition(kind).encode())
            self._channels[topic] = create(topic, message_encoding="cdr", schema=schema)
        self._asked = False  # a new viewer, for the robot's description
        self._file: foxglove.MCAPWriter | None = None
        self._table: TextIO | None = None
        self._server: foxglove.websocket.WebSocketServer | None = None

    def open_file(self, path: Path, about: Mapping[str, Any], time_ns: int, *, overwrite: bool = False) -> None:
        """Begin an MCAP file. `about`: whose it is, versions and settings. Raises FileExistsError, OSError."""
        if overwrite:  # the name alone: a program that writes this file goes on with its own
            path.unlink(missing_ok=True)
        # Without seeking, a chunk is written whole: with it, a killed recorder leaves one whose length is unknown.
        options = MCAPWriteOptions(
            profile="ros2", compression_threads=0, disable_seeking=True, chunk_size=LARGEST_CHUNK
        )
        self._file = foxglove.open_mcap(path, context=self._context, writer_options=options)
        found = {**about, "recorded_with": f"hexapod-gateway {__version__}"}
        self._file.write_metadata(METADATA, {name: json.dumps(value) for name, value in found.items()})
        self.draw((self.drawing.description(), *self.drawing.picture(time_ns)), time_ns)
        self.flush()

    def open_table(self, path: Path, *, overwrite: bool = False) -> None:
        """Begin a table: a row for each frame and each state. Raises FileExistsError, OSError.

        It has seconds since 1970, and degrees; empty where a servo is off.
        """
        self._table = path.open("w" if overwrite else "x", newline="", encoding="ascii")
        csv.writer(self._table).writerow(["time_s", *(f"servo_{servo_id}_deg" for servo_id in SERVO_IDS)])

    def serve(self, port: int) -> int:
        """Serve viewers on this machine, and return the port. Raises AddressTakenError if `port` is in use."""
        try:  # no capabilities: what a viewer publishes, calls or sets is answered with an error and goes nowhere
            self._server = foxglove.start_server(
                name="hexapod-gateway",
                host=HOST,
                port=port,
                capabilities=[],
                server_listener=self,
                context=self._context,
            )
        except RuntimeError as error:
            raise AddressTakenError(f"port {port} is taken; name another with --port") from error
        return self._server.port

    def add(self, key: str, report: Mapping[str, Any], time_ns: int) -> None:
        """Record a report (parsed JSON, on a key of `REPORTS`), and what is drawn for it."""
        data = json.dumps(report, separators=(",", ":"), ensure_ascii=False).encode()
        self._channels[key].log(data, log_time=time_ns)
        self.draw(self.drawing.take(key, report, time_ns), time_ns)
        if self._table is not None and key in (STATE, FRAME):
            joints = self.drawing.joints
            angles = (joints.deg.get(each) if joints.running.get(each) else None for each in SERVO_IDS)
            csv.writer(self._table).writerow([f"{time_ns / 1e9:.6f}", *angles])

    def draw(self, drawn: Iterable[tuple[str, Message]], time_ns: int) -> None:
        """Record messages for viewers, by topic."""
        for topic, message in drawn:
            self._channels[topic].log(encode(message), log_time=time_ns)

    def on_subscribe(self, client: Viewer, channel: ChannelView) -> None:
        """Send the robot's description, which is published only once, to a viewer that opens the 3D panel."""
        del client
        if channel.topic == DESCRIPTION:  # it is subscribed only once this has returned
            self._asked = True

    def answer_viewers(self) -> None:
        """Send the description to viewers that have asked for it."""
        if self._asked:
            self._asked = False
            self.draw([self.drawing.description()], time.time_ns())

    def flush(self) -> None:
        """Hand all data to the kernel: a killed recorder loses only later data. Raises OSError."""
        if self._table is not None:
            self._table.flush()
        with _as_os_error():
            if self._file is not None:
                self._file.flush()

    def close(self) -> None:
        """Write the file's index, end the table and the server. Raises OSError if a file cannot be written."""
        if self._server is not None:
            self._server.stop()
        if self._table is not None:
            self._table.close()
        with _as_os_error():
            if self._file is not None:
                self._file.close()


@contextmanager
def _as_os_error() -> Iterator[None]:
    """Raise what Foxglove's SDK raises for a file that cannot be written."""
    try:
        yield
    except RuntimeError as error:
        raise OSError(str(error)) from error


LOOK_S: Final = 0.1
FLUSH_S: Final = 4.0
"""A killed recorder loses at most the reports of this time. Each flush is a chunk, with an index that stays in memory:
every 0.1 s took 12 MB an hour, and more than twice the space on the disk."""
_FLUSHED_PART: Final = 0.1
"""A short recording is flushed more often: it loses a tenth."""
_PROGRESS_S: Final = 0.5
_SILENT_S: Final = 1.0
"""A gateway publishes its state ten times a second."""
MOST_WAITING: Final = 100_000
"""Reports that wait for the disk: minutes of frames. More are dropped and counted, before memory runs out."""
MOST_BEFORE_A_PICTURE: Final = 100
"""Pictures are dropped behind more than these: some 50 MB of them."""

_NAMES: Final = {STATE: "states", EVENT: "events", FRAME: "frames"}


def flush_period_s(recorded_s: float) -> float:
    """Return how long to wait with the next flush of a recording of this length."""
    return min(FLUSH_S, max(LOOK_S, _FLUSHED_PART * recorded_s))


class ReportQueue:
    """A queue from Zenoh's threads to the recorder. At most MOST_WAITING reports wait, which limits memory."""

    def __init__(self, states: States, physics: str | None = None) -> None:
        """`states` joins states with their configuration.

        `physics`: Zenoh id of the body's publisher in the newest state; later states replace it.
        """
        self._states = states
        self._physics = physics
        self._waiting: SimpleQueue[tuple[str, bytes, int] | None] = SimpleQueue()
        self._since_1970_ns = time.time_ns() - time.monotonic_ns()
        self.dropped = 0
        """The count of reports dropped because the queue was full."""
        self.invalid = 0
        """The count of invalid reports."""

    def subscribe(self, session: zenoh.Session) -> None:
        """Queue what is received, until the session is closed."""

        def receive(key: str, sample: zenoh.Sample) -> None:
            if key == SIM_BODY and not is_of_physics(sample, self._physics):
                self.invalid += 1
            else:
                self.put(key, sample.payload.to_bytes())

        for key in REPORTS:
            session.declare_subscriber(key, partial(receive, key))

    def put(self, key: str, payload: bytes, at_ns: int | None = None, most: int = MOST_WAITING) -> None:
        """Queue an entry of this monotonic time (None: now), or count it as dropped behind `most`. For any thread."""
        if self._waiting.qsize() >= most:
            self.dropped += 1
        else:
            self._waiting.put((key, payload, self.now_ns() if at_ns is None else at_ns + self._since_1970_ns))

    @contextmanager
    def follow(self, cameras: Iterable[watching.Camera]) -> Iterator[None]:
        """Queue pictures within the block; each camera has a thread of its own. A camera's trouble is printed."""
        ended = threading.Event()

        async def follow(camera: watching.Camera) -> None:
            newest: watching.Picture | None = None
            trouble = ""
            while not ended.is_set():
                if (newer := await camera.newer(newest, LOOK_S)) is not None:
                    newest = newer
                    self.put(f"{CAMERAS}{camera.name}", newest.jpeg, newest.taken_ns, MOST_BEFORE_A_PICTURE)
                if camera.trouble != trouble:
                    trouble = camera.trouble
                    hint(trouble or f"The camera {camera.name} sends pictures again.")

        threads = [threading.Thread(target=asyncio.run, args=(follow(each),), daemon=True) for each in cameras]
        for each in threads:
            each.start()
        try:
            yield
        finally:
            ended.set()
            for each in threads:
                each.join()

    def end(self) -> None:
        """Make `get` return None after all earlier entries. May be called in a signal handler."""
        self._waiting.put(None)

    def get(self, timeout_s: float) -> tuple[str, Any, int] | None:
        """Return the next entry's key, report (JPEG: bytes) and time (ns since 1970); None: the queue has ended.

        Raises queue.Empty if no entry arrives within `timeout_s`, if the entry is invalid, or if it is a state whose
        configuration is unknown.
        """
        found = self._waiting.get(timeout=max(0.0, timeout_s))
        if found is None:
            return None
        key, payload, time_ns = found
        if key.startswith(CAMERAS):
            return found
        try:
            if key != STATE:
                REPORTS[key].model_validate_json(payload)
                return key, json.loads(payload), time_ns
            state = self._states.join(payload)
        except ValidationError:
            self.invalid += 1
            raise Empty from None
        if state is None:
            raise Empty
        self._physics = state.physics
        return key, state.model_dump(mode="json"), time_ns

    def now_ns(self) -> int:
        """Return ns since 1970, by a clock that never jumps."""
        return time.monotonic_ns() + self._since_1970_ns


def record(connect: Connection, options: RecordOptions) -> int:
    """Record until a signal, or for `seconds`. Returns the exit code. Raises AddressTakenError, ConfigError."""
    cameras, path = watching.cameras(options.camera or ()), options.file
    recording = Recording(load(options.geometry), cameras)
    with connect() as client:
        state = client.state()
        port = recording.serve(options.port) if options.live else None
        if path is not None:
            _open(recording, path, state, table=options.csv, overwrite=options.force)
        if port is not None:
            say(f"In Foxglove or Lichtblick, open the Foxglove WebSocket ws://{HOST}:{port}; Ctrl-C ends")
        reports = ReportQueue(client.states, state.physics)
        if state.calibration.revision:  # so that the frames can be read; the default, and an older gateway, have 0
            reports.put(CALIBRATION, client.calibration().model_dump_json().encode())
        if client.states.config is not None:
            reports.put(CONFIG, client.states.config.model_dump_json().encode())
        reports.subscribe(client.session)
        with on_end_signals(reports.end), reports.follow(cameras.values()):
            if path is not None and state.telemetry.frames is False:
                hint(
                    "The gateway publishes no frames, so the recording will have none: set telemetry.frames = true in "
                    "its settings and restart it, or go on without."
                )
            if path is not None:
                hint(f"recording into {path}; Ctrl-C ends it")
            return _Recorder(recording, reports, path).run(options.seconds)


def _open(recording: Recording, path: Path, state: GatewayState, *, table: bool, overwrite: bool) -> None:
    """Open the files. Raises ConfigError."""
    for each in (path, path.with_suffix(".csv"))[: 1 + table]:
        if each.exists() and not overwrite:
            raise ConfigError(f"{each}: exists; name another file, or overwrite it with --force")
    about = state.model_dump(mode="json", include={"version", "protocol", "simulated", "spi", "watchdog", "limits"})
    try:
        recording.open_file(path, about, time.time_ns(), overwrite=overwrite)
        if table:
            recording.open_table(path.with_suffix(".csv"), overwrite=overwrite)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written ({error.strerror or error})") from error


class _Recorder:
    def __init__(self, recording: Recording, reports: ReportQueue, path: Path | None) -> None:
        self._recording = recording
        self._reports = reports
        self._path = path
        self._begun_s = self._received_s = time.monotonic()
        self._counts: Counter[str] = Counter()
        self._silent = False

    def run(self, seconds: float | None) -> int:
        """Write until the end. Returns the exit code."""
        end_s = None if seconds is None else self._begun_s + seconds
        try:
            self._write_until(end_s)
            self._recording.close()
        except OSError as error:
            clear_line()
            raise GatewayError(
                f"{self._path}: cannot be written any more ({error.strerror or error}). What came before can be read; "
                f"once there is room, `mcap recover {self._path} -o FILE` makes a whole file of it"
            ) from error
        clear_line()
        say(f"{self._path or 'live'}: {self._summary()}")
        if self._reports.dropped:
            hint(f"{self._reports.dropped} reports are missing: the disk was too slow.")
        if self._reports.invalid:
            hint(f"{self._reports.invalid} messages on the gateway's keys were no reports, and are not in the file.")
        return 0

    def _write_until(self, end_s: float | None) -> None:
        progress_s = flush_s = self._begun_s
        while (now_s := time.monotonic()) < (end_s or now_s + 1):
            self._recording.answer_viewers()
            if now_s >= flush_s:
                flush_s = now_s + flush_period_s(now_s - self._begun_s)
                self._recording.flush()
            if now_s >= progress_s:
                progress_s = now_s + _PROGRESS_S
                show_line(self._summary())
            if not self._silent and now_s - self._received_s > _SILENT_S:
                self._silent = True
                self._warn("the gateway is silent: this is the last that it published")
            with suppress(Empty):
                received = self._reports.get(min(now_s + LOOK_S, end_s or now_s + LOOK_S) - now_s)
                if received is None:
                    return
                self._write(*received)

    def _write(self, key: str, report: Any, time_ns: int) -> None:
        if isinstance(report, bytes):
            self._counts[CAMERAS] += 1
            self._recording.draw([self._recording.drawing.camera(key, report, time_ns)], time_ns)
            return
        self._received_s = time.monotonic()
        self._counts[key] += 1
        if self._silent:
            self._silent = False
            self._warn("the gateway publishes again")
        self._recording.add(key, report, time_ns)

    def _warn(self, sentence: str) -> None:
        hint(sentence)
        now_ns = self._reports.now_ns()
        self._recording.draw([(LOG, log_line(LOG_WARN, sentence, now_ns))], now_ns)

    def _summary(self) -> str:
        counts = ", ".join(f"{self._counts[key]} {name}" for key, name in _NAMES.items())
        counts += f", {self._counts[CAMERAS]} pictures" if self._counts[CAMERAS] else ""
        size = f", {self._path.stat().st_size / 1e6:.1f} MB" if self._path and self._path.exists() else ""
        return f"{time.monotonic() - self._begun_s:.1f} s, {counts}{size}"
