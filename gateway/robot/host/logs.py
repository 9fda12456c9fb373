"""How the service logs: readable on a terminal, JSON lines for the journal; and no Stop waits for it."""

import atexit
import faulthandler
import json
import logging
import os
import signal
import sys
import time
from collections.abc import Callable
from datetime import UTC, datetime
from typing import Any, Final, Literal

import structlog

from gateway.robot.host.directories import runtime_directory
from gateway.robot.host.log_writer import LogWriter, Stream
from gateway.robot.settings import LogSettings

FLUSH_S: Final = 0.3
"""How long the end waits for unwritten lines: what the Stops leave of its second (docs/interface.md, Behaviour 7)."""

_log_writers: list[LogWriter] = []


def set_up(settings: LogSettings) -> None:
    """Render what `logging` gets as the settings say, and write it to stderr.

    From now on two threads of this module write to stdout and stderr; nobody else waits for these.
    """
    render = _formatter(settings, os.isatty(2)).format
    out, err = LogWriter(1), LogWriter(2, _with_priority(render) if _is_journal(2) else render)
    _log_writers[:] = [out, err]
    sys.stdout, sys.stderr = Stream(out), Stream(err)
    atexit.register(close)
    root = logging.getLogger()
    root.handlers[:] = [_Handler(err)]
    root.setLevel(settings.level.upper())


def _is_journal(descriptor: int) -> bool:
    """Whether systemd has connected it to the journal, by its own word (systemd.exec(5), JOURNAL_STREAM)."""
    found = os.fstat(descriptor)
    return os.environ.get("JOURNAL_STREAM") == f"{found.st_dev}:{found.st_ino}"


def _with_priority(render: Callable[[logging.LogRecord], str]) -> Callable[[logging.LogRecord], str]:
    """Begin each line with its syslog priority, so that `journalctl -p warning` finds it; the journal takes it off."""

    def rendered(record: logging.LogRecord) -> str:
        levels = ((logging.CRITICAL, 2), (logging.ERROR, 3), (logging.WARNING, 4), (logging.INFO, 6))
        priority = next((number for level, number in levels if record.levelno >= level), 7)
        return "\n".join(f"<{priority}>{line}" for line in render(record).split("\n"))

    return rendered


def close(timeout_s: float = FLUSH_S) -> None:
    """Write the lines that wait, for at most this long."""
    end = time.monotonic() + timeout_s
    for log_writer in reversed(_log_writers):
        log_writer.close(max(0.0, end - time.monotonic()))
    _log_writers.clear()


def dropped() -> int:
    """How many lines were not written, because nobody read what came before them."""
    return sum(log_writer.dropped for log_writer in _log_writers)


def keep_stacks() -> None:
    """Under systemd: after a crash or a hang, the stacks of all threads are in a file in the service's folder.

    Not on stderr: the handler writes from within the signal. With a stuck stderr the process would not die, and
    `stop-servos` would not run. The folder is in memory, so writing never blocks. The unit logs the file afterwards.
    """
    folder = runtime_directory()
    if folder is not None:
        try:
            stacks = (folder / "stacks").open("w")
            faulthandler.enable(stacks)
            faulthandler.register(signal.SIGALRM, stacks, chain=True)  # see SystemdNotifier; `chain`: then it ends
        except OSError as error:
            logging.getLogger(__name__).warning("the stacks of a hang cannot be kept: %s", error)


class _Handler(logging.Handler):
    """Puts records into the log_writer's queue.

    `logging.handlers.QueueHandler` would render exceptions here, which reads files. It would also take a lock, which
    another thread may hold while it waits for a processor.
    """

    def __init__(self, log_writer: LogWriter) -> None:
        super().__init__()
        self._log_writer = log_writer

    def handle(self, record: logging.LogRecord) -> bool:
        """Format the message now: its arguments may change later."""
        try:
            record.msg, record.args = record.getMessage(), None
        except Exception:
            self.handleError(record)
        else:
            self._log_writer.put(record)
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
    structlog.tracebacks.ExceptionDictTransformer(show_locals=False)  # locals may hold passwords, and are long
)


def _one_line(event: object, **options: Any) -> str:
    """JSON in which unprintable characters are escaped: some end a line for some readers, or control a terminal."""
    text = json.dumps(event, ensure_ascii=False, **options)
    return text if text.isprintable() else "".join(c if c.isprintable() else json.dumps(c)[1:-1] for c in text)


def _without_control_characters(
    _logger: structlog.typing.WrappedLogger, _name: str, event: structlog.typing.EventDict
) -> structlog.typing.EventDict:
    """A sender's text must neither control the terminal nor look like lines of the log. (JSON escapes by itself.)"""
    return {key: _visible(value) if isinstance(value, str) else value for key, value in event.items()}


def _visible(text: str) -> str:
    return "".join(char if char.isprintable() else repr(char)[1:-1] for char in text)


def _with_time(
    _logger: structlog.typing.WrappedLogger, _name: str, event: structlog.typing.EventDict
) -> structlog.typing.EventDict:
    """The time of the log call, which may be long before the line is written."""
    said = datetime.fromtimestamp(event["_record"].created, UTC)
    return {**event, "timestamp": said.isoformat().replace("+00:00", "Z")}


def _without_nulls(
    _logger: structlog.typing.WrappedLogger, _name: str, event: structlog.typing.EventDict
) -> structlog.typing.EventDict:
    return {key: value for key, value in event.items() if value is not None}
