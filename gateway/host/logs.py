"""How the service logs: for people on a terminal, as JSON lines for the journal; and never in the way of a Stop."""

import atexit
import faulthandler
import json
import logging
import os
import sys
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final, Literal

import structlog

from gateway.host.outlet import Outlet, Stream
from gateway.settings import LogSettings

FLUSH_S: Final = 0.3
"""What the end waits for lines that are still to be written: of the contract's second, what its Stops leave."""

_outlets: list[Outlet] = []


def set_up(settings: LogSettings) -> None:
    """Send everything that is logged through `logging` to stderr, rendered as the settings say.

    From now on only threads of their own write to stdout and stderr, whoever has something to say there.
    """
    out, err = Outlet(1), Outlet(2, _formatter(settings, os.isatty(2)).format)
    _outlets[:] = [out, err]
    sys.stdout, sys.stderr = Stream(out), Stream(err)
    atexit.register(close)
    root = logging.getLogger()
    root.handlers[:] = [_Handler(err)]
    root.setLevel(settings.level.upper())


def close(timeout_s: float = FLUSH_S) -> None:
    """Write what waits; after so long the process goes without it."""
    end = time.monotonic() + timeout_s
    for outlet in reversed(_outlets):
        outlet.close(max(0.0, end - time.monotonic()))
    _outlets.clear()


def dropped() -> int:
    """How many lines were not written, for nobody read them."""
    return sum(outlet.dropped for outlet in _outlets)


def keep_stacks() -> None:
    """Under systemd: what a crash or a hang ends leaves the stacks of its threads in the service's own folder.

    Not on stderr: the handler writes from within the signal, and with a stuck stderr the process would not die of it,
    and nobody stop the servos. The folder is in memory, so nothing there waits; the unit shows them afterwards.
    """
    folder = os.environ.get("RUNTIME_DIRECTORY")
    if folder:
        try:
            faulthandler.enable((Path(folder) / "stacks").open("w"))
        except OSError as error:
            logging.getLogger(__name__).warning("a hang would leave no stacks: %s", error)


class _Handler(logging.Handler):
    """Puts records into the outlet's queue.

    `logging.handlers.QueueHandler` would render an exception here, which reads files, and take a lock that a thread
    may hold while it waits for a processor.
    """

    def __init__(self, outlet: Outlet) -> None:
        super().__init__()
        self._outlet = outlet

    def handle(self, record: logging.LogRecord) -> bool:
        """Take the arguments as they are now: later they may have changed."""
        try:
            record.msg, record.args = record.getMessage(), None
        except Exception:
            self.handleError(record)
        else:
            self._outlet.put(record)
        return True


def _formatter(settings: LogSettings, terminal: bool) -> logging.Formatter:
    shape: Literal["console", "json"]
    shape = settings.format if settings.format != "auto" else "console" if terminal else "json"
    shared: list[structlog.typing.Processor] = [
        structlog.stdlib.add_log_level,
        structlog.stdlib.add_logger_name,
        structlog.stdlib.ExtraAdder(),
        _without_nulls,
        _with_time,
    ]
    renderer: list[structlog.typing.Processor] = (
        [
            _without_control_characters,
            structlog.dev.ConsoleRenderer(
                colors=terminal,
                event_key="message",
                exception_formatter=structlog.dev.plain_traceback,
            ),
        ]
        if shape == "console"
        else [_TRACEBACKS, structlog.processors.JSONRenderer(_one_line)]
    )
    return structlog.stdlib.ProcessorFormatter(
        foreign_pre_chain=shared,
        processors=[
            structlog.stdlib.ProcessorFormatter.remove_processors_meta,
            structlog.processors.EventRenamer("message"),
            *renderer,
        ],
    )


_TRACEBACKS: Final = structlog.processors.ExceptionRenderer(
    structlog.tracebacks.ExceptionDictTransformer(show_locals=False)  # they would hold passwords, and are long
)


def _one_line(event: object, **options: Any) -> str:
    """Readable JSON; what ends a line for some reader, or steers a terminal, stays an escape (JSON allows it raw)."""
    text = json.dumps(event, ensure_ascii=False, **options)
    return text if text.isprintable() else "".join(c if c.isprintable() else json.dumps(c)[1:-1] for c in text)


def _without_control_characters(
    _logger: structlog.typing.WrappedLogger, _name: str, event: structlog.typing.EventDict
) -> structlog.typing.EventDict:
    """What others wrote must neither steer the terminal nor look like lines of ours; JSON escapes by itself."""
    return {key: _visible(value) if isinstance(value, str) else value for key, value in event.items()}


def _visible(text: str) -> str:
    return "".join(char if char.isprintable() else repr(char)[1:-1] for char in text)


def _with_time(
    _logger: structlog.typing.WrappedLogger, _name: str, event: structlog.typing.EventDict
) -> structlog.typing.EventDict:
    """When it was said, which may be long before it can be written."""
    said = datetime.fromtimestamp(event["_record"].created, UTC)
    return {**event, "timestamp": said.isoformat().replace("+00:00", "Z")}


def _without_nulls(
    _logger: structlog.typing.WrappedLogger, _name: str, event: structlog.typing.EventDict
) -> structlog.typing.EventDict:
    return {key: value for key, value in event.items() if value is not None}
