"""`foxglove`: what the gateway says, live for Foxglove and Lichtblick. Read only: a viewer is no console."""

import json
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any, Final

import zenoh
from pydantic import TypeAdapter, ValidationError

from gateway.errors import AddressTakenError, ConfigError
from gateway.geometry import load
from gateway.people.client.blocking import Client
from gateway.people.recordings.drawing import DESCRIPTION, DRAWN_SCHEMAS, LOG, Drawing, warning
from gateway.people.recordings.plain_schema import plain_schema, without_nulls
from gateway.people.recordings.writing import REPORTS
from gateway.people.tools.reach import Connection
from gateway.people.tools.signals import on_end_signals
from gateway.people.tools.terminal import hint, say
from schemas.keys import STATE

try:
    import foxglove
    from foxglove.websocket import ChannelView, ServerListener
    from foxglove.websocket import Client as Viewer
except ImportError as error:
    raise ConfigError("the viewers' server is missing: pip install 'hexapod-gateway[foxglove]'") from error

HOST: Final = "127.0.0.1"
"""This machine only: its WebSocket asks nobody who they are. From elsewhere, `ssh -L` leads here."""
DEFAULT_PORT: Final = 8765
"""Where viewers look."""
SILENT_S: Final = 1.0
"""A gateway publishes its state ten times a second."""
MOST_WAITING: Final = 10_000

Heard = tuple[str, bytes, int]


def serve(connect: Connection, *, port: int, geometry: Path | None) -> int:
    """Serve until a signal. Returns the exit code. Raises AddressTakenError, ConfigError, ZenohError."""
    shape = load(geometry)
    with connect() as client:
        client.state()
        live = _Live(Drawing(shape), port)
        with live.hears(client), on_end_signals(live.end):
            say(f"In Foxglove or Lichtblick, open the Foxglove WebSocket ws://{HOST}:{live.port}; Ctrl-C ends")
            live.run()
    return 0


class _Live(ServerListener):
    """Zenoh's threads put what they hear into a queue; the calling thread draws it and hands it to the server."""

    def __init__(self, drawing: Drawing, port: int) -> None:
        self._drawing = drawing
        self._waiting: SimpleQueue[Heard | None] = SimpleQueue()
        self._silent = False
        self._state_ns: int | None = None
        self._since_1970_ns = time.time_ns() - time.monotonic_ns()
        self._context = foxglove.Context()  # kept, since its channels end with it
        schemas = dict(DRAWN_SCHEMAS)
        schemas |= {key: plain_schema(TypeAdapter(model), model.__name__) for key, model in REPORTS.items()}
        self._channels = {
            topic: foxglove.Channel(topic, schema=schema, context=self._context) for topic, schema in schemas.items()
        }
        try:
            # No capabilities: what a viewer publishes, calls or sets is answered with an error and goes nowhere.
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

    @property
    def port(self) -> int:
        """Where it listens."""
        return self._server.port

    @contextmanager
    def hears(self, client: Client) -> Iterator[None]:
        """What the gateway publishes meanwhile is heard."""
        subscribers: list[Any] = [client.session.declare_subscriber(key, partial(self._take, key)) for key in REPORTS]
        try:
            yield
        finally:
            for subscriber in subscribers:
                with suppress(zenoh.ZError):
                    subscriber.undeclare()
            self._server.stop()

    def end(self) -> None:
        """End it; also from a signal handler."""
        self._waiting.put(None)

    def run(self) -> None:
        """Until `end`."""
        while True:
            try:
                heard = self._waiting.get(timeout=SILENT_S)
            except Empty:
                self._is_silent()
                continue
            if heard is None:
                return
            key, payload, time_ns = heard
            if key == DESCRIPTION:
                self._log(*self._drawing.description(), time_ns)
                continue
            with suppress(ValidationError):  # without access control, anybody may publish there
                REPORTS[key].model_validate_json(payload)
                report: dict[str, Any] = json.loads(payload)
                if key == STATE:
                    self._is_there(report["uptime_s"], time_ns)
                self._log(key, report, time_ns)
                for topic, message in self._drawing.take(key, report, time_ns):
                    self._log(topic, message, time_ns)

    def _is_silent(self) -> None:
        """What the viewer shows stands still from now on, and says why."""
        if not self._silent:
            self._silent = True
            self._say(
                "nothing is received from the gateway: what is shown is the last that it published", self._now_ns()
            )

    def _is_there(self, uptime_s: float, time_ns: int) -> None:
        begun_ns = time_ns - round(uptime_s * 1e9)
        if self._state_ns is not None and begun_ns > self._state_ns:  # after the newest state of the gateway before it
            self._say("the gateway was started again: all legs are stopped", time_ns)
        elif self._silent:
            self._say("the gateway is received again", time_ns)
        self._silent, self._state_ns = False, time_ns

    def _say(self, sentence: str, time_ns: int) -> None:
        hint(sentence)
        self._log(LOG, warning(sentence, time_ns), time_ns)

    def on_subscribe(self, client: Viewer, channel: ChannelView) -> None:
        """The server's: who opens the 3D panel is sent the robot's description, which comes only once."""
        del client
        if channel.topic == DESCRIPTION:
            self._waiting.put((DESCRIPTION, b"", self._now_ns()))

    def _take(self, key: str, sample: zenoh.Sample) -> None:
        if self._waiting.qsize() < MOST_WAITING:
            self._waiting.put((key, sample.payload.to_bytes(), self._now_ns()))

    def _now_ns(self) -> int:
        return time.monotonic_ns() + self._since_1970_ns

    def _log(self, topic: str, message: dict[str, Any], time_ns: int) -> None:
        data = json.dumps(without_nulls(message), separators=(",", ":"), ensure_ascii=False).encode()
        self._channels[topic].log(data, log_time=time_ns)
