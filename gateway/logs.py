"""How the service logs: for people on a terminal, as JSON lines for the journal."""

import json
import logging
import sys
from typing import Any, Final, Literal

import structlog

from gateway.settings import LogSettings


def set_up(settings: LogSettings) -> None:
    """Send everything that is logged through `logging` to stderr, rendered as the settings say."""
    shape: Literal["console", "json"]
    shape = settings.format if settings.format != "auto" else "console" if sys.stderr.isatty() else "json"
    shared: list[structlog.typing.Processor] = [
        structlog.stdlib.add_log_level,
        structlog.stdlib.add_logger_name,
        structlog.stdlib.ExtraAdder(),
        _without_nulls,
        structlog.processors.TimeStamper(fmt="iso", utc=True),
    ]
    renderer: list[structlog.typing.Processor] = (
        [
            _without_control_characters,
            structlog.dev.ConsoleRenderer(
                colors=sys.stderr.isatty(),
                event_key="message",
                exception_formatter=structlog.dev.plain_traceback,
            ),
        ]
        if shape == "console"
        else [_TRACEBACKS, structlog.processors.JSONRenderer(_one_line)]
    )
    formatter = structlog.stdlib.ProcessorFormatter(
        foreign_pre_chain=shared,
        processors=[
            structlog.stdlib.ProcessorFormatter.remove_processors_meta,
            structlog.processors.EventRenamer("message"),
            *renderer,
        ],
    )
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(formatter)
    root = logging.getLogger()
    root.handlers[:] = [handler]
    root.setLevel(settings.level.upper())


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


def _without_nulls(
    _logger: structlog.typing.WrappedLogger, _name: str, event: structlog.typing.EventDict
) -> structlog.typing.EventDict:
    return {key: value for key, value in event.items() if value is not None}
