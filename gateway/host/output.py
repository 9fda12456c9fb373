"""Standard output and standard error that may fail: a full disk, or a reader that has ended."""

import io
import sys
from collections.abc import Callable


class Output(io.TextIOWrapper):
    """A stream that drops its text from its first failure on, which it keeps.

    So a command finishes its work, such as the delivery of a revocation, and Python's own end does not fail.
    """

    failure = ""

    def write(self, text: str) -> int:
        self._attempt(super().write, text)
        return len(text)

    def flush(self) -> None:
        self._attempt(super().flush)

    def _attempt(self, function: Callable[..., object], *arguments: str) -> None:
        try:
            if not self.failure:
                function(*arguments)
        except OSError as error:
            self.failure = error.strerror or str(error)


def guard() -> None:
    """Let `sys.stdout` and `sys.stderr` be such streams. A character that a terminal lacks, such as µ, is escaped."""
    for name in ("stdout", "stderr"):
        old = getattr(sys, name)
        if isinstance(old, io.TextIOWrapper):
            form = {each: getattr(old, each) for each in ("encoding", "line_buffering", "write_through")}
            stream = Output(old.detach(), errors="backslashreplace", **form)
            setattr(sys, name, stream)
            setattr(sys, f"__{name}__", stream)


def failed() -> str:
    """Return why standard output could not be written, or ""."""
    sys.stdout.flush()
    return getattr(sys.stdout, "failure", "")


def finish(code: int) -> int:
    """Write the rest of the output. Return the exit code of a command that would end with `code`."""
    if why := failed():
        sys.stderr.write(f"hexapod-gateway: cannot write the output: {why}\n")
        code = code or 1
    sys.stderr.flush()
    return code
