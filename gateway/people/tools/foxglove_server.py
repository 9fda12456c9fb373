"""`foxglove`: what the gateway publishes, live for Foxglove and Lichtblick. Read only: a viewer is no console."""

import json
from collections.abc import Collection
from contextlib import closing
from datetime import datetime
from pathlib import Path
from queue import Empty
from typing import Any, Final

from pydantic import TypeAdapter

from gateway.errors import AddressTakenError, ConfigError
from gateway.geometry import load
from gateway.people.client.live import Order, ReportQueue, Starts
from gateway.people.recordings.drawing import DESCRIPTION, DRAWN, LOG, Drawing, warning
from gateway.people.recordings.plain_schema import plain_schema, without_nulls
from gateway.people.recordings.writing import REPORTS, ROS_ENCODING, ROS_SCHEMA_ENCODING
from gateway.people.ros2.cdr import definition, encode
from gateway.people.ros2.messages import Message
from gateway.people.terminal import hint, on_end_signals, say
from gateway.people.tools.reach import Connection
from gateway.people.tools.viewer_access import Pair, ViewerAccess
from schemas.keys import STATE

try:
    import foxglove
    from foxglove.websocket import ChannelView, ServerListener
    from foxglove.websocket import Client as Viewer
except ImportError as error:
    raise ConfigError("the viewers' server is missing: pip install 'hexapod-gateway[foxglove]'") from error

HOST: Final = "127.0.0.1"
"""This machine only. From elsewhere, `ssh -L` leads here."""
_NAME: Final = "viewers.invalid"
"""Of the server behind `ViewerAccess`."""
_SILENT_S: Final = 1.0
"""A gateway publishes its state ten times a second."""
_MOST_WAITING: Final = 10_000


def serve(connect: Connection, *, port: int, geometry: Path | None, origins: Collection[str] = ()) -> int:
    """Serve until a signal. Returns the exit code. Raises AddressTakenError, ConfigError, ZenohError."""
    shape = load(geometry)
    with connect() as client:
        reports = ReportQueue(REPORTS, _MOST_WAITING, client.state().physics)
        try:
            access = ViewerAccess(HOST, port, origins)
        except OSError as error:
            raise AddressTakenError(f"port {port} is taken; name another with --port") from error
        pair = Pair(_NAME)
        server = _Server(Drawing(shape), reports, pair)
        access.open(server.port, _NAME, pair.certificate)
        with closing(server), closing(access), reports.receives(client.session), on_end_signals(reports.end):
            say(f"In Foxglove or Lichtblick, open the Foxglove WebSocket ws://{HOST}:{access.port}; Ctrl-C ends")
            server.run()
    return 0


class _Server(ServerListener):
    """Draws reports on the calling thread, and passes them to the viewers' server."""

    def __init__(self, drawing: Drawing, reports: ReportQueue, pair: Pair) -> None:
        self._drawing = drawing
        self._reports = reports
        self._starts = Starts()
        self._silent = False
        self._context = foxglove.Context()  # kept, since its channels end with it
        self._channels = {
            key: self._channel(key, plain_schema(TypeAdapter(model), model.__name__), "json")
            for key, model in REPORTS.items()
        }
        for topic, kind in DRAWN.items():
            schema = foxglove.Schema(name=kind.TYPE, encoding=ROS_SCHEMA_ENCODING, data=definition(kind).encode())
            self._channels[topic] = self._channel(topic, schema, ROS_ENCODING)
        # No capabilities: what a viewer publishes, calls or sets is answered with an error and goes nowhere.
        self._server = foxglove.start_server(
            name="hexapod-gateway",
            host=HOST,
            port=0,
            capabilities=[],
            server_listener=self,
            context=self._context,
            tls_cert=pair.certificate,
            tls_key=pair.key,
        )

    def _channel(self, topic: str, schema: "dict[str, Any] | foxglove.Schema", encoding: str) -> "foxglove.Channel":
        return foxglove.Channel(topic, schema=schema, message_encoding=encoding, context=self._context)

    @property
    def port(self) -> int:
        """The TCP port on which the server listens."""
        return self._server.port

    def run(self) -> None:
        """Draw until the reports end."""
        while True:
            try:
                received = self._reports.get(_SILENT_S)
            except Empty:
                self._is_silent()
                continue
            if received is None:
                return
            key, report, time_ns = received
            if key == DESCRIPTION:
                self._draw(*self._drawing.description(), time_ns)
                continue
            if key == STATE:
                self._is_there(report, time_ns)
            self._log(key, report, time_ns)
            for topic, message in self._drawing.take(key, report, time_ns):
                self._draw(topic, message, time_ns)

    def close(self) -> None:
        """Stop the server."""
        self._server.stop()

    def _is_silent(self) -> None:
        """Warn once: the viewer shows old data from now on."""
        if not self._silent:
            self._silent = True
            self._warn(
                "the gateway is silent: this is the last that it published",
                self._reports.now_ns(),
            )

    def _is_there(self, state: dict[str, Any], time_ns: int) -> None:
        began = datetime.fromisoformat(state["time"])
        if self._starts.look(began, state["uptime_s"], time_ns) is Order.RESTARTED:
            self._warn("the gateway was started again: all legs are stopped", time_ns)
        elif self._silent:
            self._warn("the gateway publishes again", time_ns)
        self._silent = False

    def _warn(self, sentence: str, time_ns: int) -> None:
        hint(sentence)
        self._draw(LOG, warning(sentence, time_ns), time_ns)

    def on_subscribe(self, client: Viewer, channel: ChannelView) -> None:
        """Send the robot's description, which is published only once, to a viewer that opens the 3D panel."""
        del client
        if channel.topic == DESCRIPTION:
            self._reports.put(DESCRIPTION)

    def _log(self, topic: str, message: dict[str, Any], time_ns: int) -> None:
        data = json.dumps(without_nulls(message), separators=(",", ":"), ensure_ascii=False).encode()
        self._channels[topic].log(data, log_time=time_ns)

    def _draw(self, topic: str, message: Message, time_ns: int) -> None:
        self._channels[topic].log(encode(message), log_time=time_ns)
