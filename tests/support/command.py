"""A command of ours in this process: what it prints and its exit code, without the half second of a new Python.

For what a command says of its arguments. What signals, terminals or threads have a part in is run by `Child`.
"""

import contextlib
import io
import sys
from typing import NamedTuple, NoReturn
from unittest.mock import patch

from gateway import cli


class Ended(NamedTuple):
    """How it ended."""

    returncode: int
    stdout: str
    stderr: str


def run_here(*arguments: str) -> Ended:
    """Run `hexapod-gateway` with these arguments."""
    with (
        contextlib.redirect_stdout(io.StringIO()) as stdout,
        contextlib.redirect_stderr(io.StringIO()) as stderr,
        patch.object(sys, "argv", ["hexapod-gateway", *arguments]),
        patch.object(cli, "_end", _end),  # which may end the process
    ):
        try:
            cli.main()
            code = 0
        except SystemExit as end:
            code = int(end.code or 0)
    return Ended(code, stdout.getvalue(), stderr.getvalue())


def _end(code: int) -> NoReturn:
    raise SystemExit(code)
