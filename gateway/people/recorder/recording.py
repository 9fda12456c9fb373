"""What a gateway publishes, and what viewers draw of it: one context of the Foxglove SDK.

An MCAP file and a live server are its sinks. Reports are logged as they were published.
"""

import json
import time
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Final

from pydantic import BaseModel

from gateway import __version__
from gateway.errors import AddressTakenError, ConfigError
from gateway.geometry import Geometry
from gateway.people.recorder.drawing import DESCRIPTION, DRAWN, LOG, Drawing, definition, encode, warning
from gateway.people.ros2.messages import Message
from schemas.calibration import Calibration
from schemas.keys import CALIBRATION, EVENT, FRAME, SIM_BODY, STATE, TELEMETRY
from schemas.telemetry import BodyReport, Event, FrameRecord, GatewayState, Telemetry

try:
    import foxglove
    import rosbags  # noqa: F401  # `drawing` can be imported without
    from foxglove.mcap import MCAPWriteOptions
    from foxglove.websocket import ChannelView, ServerListener
    from foxglove.websocket import Client as Viewer
except ImportError as error:
    raise ConfigError("to record, type: pip install 'hexapod-gateway[record]'") from error

HOST: Final = "127.0.0.1"
"""Viewers on this machine only. From elsewhere, `ssh -L` leads here."""
METADATA: Final = "hexapod-gateway"

REPORTS: Final[Mapping[str, type[BaseModel]]] = {
    STATE: GatewayState,
    EVENT: Event,
    FRAME: FrameRecord,
    CALIBRATION: Calibration,
    TELEMETRY: Telemetry,
    SIM_BODY: BodyReport,
}
"""The keys that are recorded, which are their channels' names, and what is published there."""


class Recording(ServerListener):
    """Logs to the sinks that were opened. Times are nanoseconds since 1970."""

    def __init__(self, geometry: Geometry) -> None:
        self.drawing = Drawing(geometry)
        self._context = foxglove.Context()
        # `foxglove.Channel` gives JSON a schema, and rosbags 0.11 opens no file that has one.
        create = self._context._create_channel
        self._channels = {key: create(key, message_encoding="json") for key in REPORTS}
        for topic, kind in DRAWN.items():
            schema = foxglove.Schema(name=kind.TYPE, encoding="ros2msg", data=definition(kind).encode())
            self._channels[topic] = create(topic, message_encoding="cdr", schema=schema)
        self._asked = False  # a new viewer, for the robot's description
        self._file: foxglove.MCAPWriter | None = None
        self._server: foxglove.websocket.WebSocketServer | None = None

    def open_file(self, path: Path, about: Mapping[str, Any], time_ns: int, *, overwrite: bool = False) -> None:
        """Begin an MCAP file. `about`: whose it is, versions and settings. Raises FileExistsError, OSError."""
        if overwrite:  # the name alone: a program that writes this file goes on with its own
            path.unlink(missing_ok=True)
        # Without seeking, a chunk is written whole: with it, a killed recorder leaves one whose length is unknown.
        options = MCAPWriteOptions(profile="ros2", compression_threads=0, disable_seeking=True)
        self._file = foxglove.open_mcap(path, context=self._context, writer_options=options)
        found = {**about, "recorded_with": f"hexapod-gateway {__version__}"}
        self._file.write_metadata(METADATA, {name: json.dumps(value) for name, value in found.items()})
        self._draw((self.drawing.description(), *self.drawing.picture(time_ns)), time_ns)
        self.flush()

    def serve(self, port: int) -> int:
        """Let viewers on this machine look, and return the port. Raises AddressTakenError."""
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
        """A report (as its JSON, on one of `REPORTS`), and what is drawn for it."""
        data = json.dumps(report, separators=(",", ":"), ensure_ascii=False).encode()
        self._channels[key].log(data, log_time=time_ns)
        self._draw(self.drawing.take(key, report, time_ns), time_ns)

    def warn(self, sentence: str, time_ns: int) -> None:
        """A line of the viewers' log."""
        self._draw([(LOG, warning(sentence, time_ns))], time_ns)

    def _draw(self, drawn: Iterable[tuple[str, Message]], time_ns: int) -> None:
        for topic, message in drawn:
            self._channels[topic].log(encode(message), log_time=time_ns)

    def on_subscribe(self, client: Viewer, channel: ChannelView) -> None:
        """Send the robot's description, which is published only once, to a viewer that opens the 3D panel."""
        del client
        if channel.topic == DESCRIPTION:  # it is subscribed only once this has returned
            self._asked = True

    def flush(self) -> None:
        """Hand all to the kernel: a killed recorder loses only what comes later. Raises OSError."""
        if self._asked:
            self._asked = False
            self._draw([self.drawing.description()], time.time_ns())
        if self._file is not None:
            try:
                self._file.flush()
            except RuntimeError as error:
                raise OSError(str(error)) from error

    def close(self) -> None:
        """Write the file's index, so that readers find their way, and end the server. Raises OSError."""
        if self._server is not None:
            self._server.stop()
        if self._file is not None:
            try:
                self._file.close()
            except RuntimeError as error:
                raise OSError(str(error)) from error


def about(state: GatewayState) -> dict[str, Any]:
    """Versions, and the settings that the state shows."""
    return state.model_dump(mode="json", include={"version", "protocol", "simulated", "spi", "watchdog", "limits"})
