"""A command of ours in this process: what it prints and its exit code, without the second of a new Python.

What signals, terminals or the end of a process have a part in is run by `Child`; another program by `run_program`.
"""

import contextlib
import io
import shlex
import signal
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from types import FrameType
from typing import Any, NamedTuple
from unittest.mock import patch

import typer

from gateway import cli
from gateway.onboard.commands import setup_app


class Ended(NamedTuple):
    """A command's exit code and output."""

    returncode: int
    stdout: str
    stderr: str


def run_here(*arguments: str, timeout_s: float = 60) -> Ended:
    """Run `hexapod-gateway` with these arguments. Raises TimeoutError."""
    with (
        _at_most(timeout_s),
        contextlib.redirect_stdout(io.StringIO()) as stdout,
        contextlib.redirect_stderr(io.StringIO()) as stderr,
        patch.object(sys, "argv", ["hexapod-gateway", *arguments]),
        patch.object(cli, "_end", sys.exit),  # its own may end the process
    ):
        try:
            cli.main()
            code = 0
        except SystemExit as end:
            code = int(end.code or 0)
    return Ended(code, stdout.getvalue(), stderr.getvalue())


@contextlib.contextmanager
def _at_most(timeout_s: float) -> Iterator[None]:
    def late(_number: int, _frame: FrameType | None) -> None:
        raise TimeoutError(f"the command still runs after {timeout_s} s")

    before = signal.signal(signal.SIGALRM, late)
    signal.setitimer(signal.ITIMER_REAL, timeout_s)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def run_program(*command: str | Path, code: int = 0, **options: Any) -> subprocess.CompletedProcess[str]:
    """Run a program until its end. Raises AssertionError with its output if its exit status is not `code`."""
    done = subprocess.run(command, capture_output=True, text=True, check=False, **options)
    assert done.returncode == code, f"{done.args} ended with {done.returncode}:\n{done.stdout}{done.stderr}"
    return done


@cache
def program() -> Any:
    """Return the program's commands, and the Debian package's `setup`."""
    group: Any = typer.main.get_command(cli.app)
    group.add_command(typer.main.get_command(setup_app), "setup")
    return group


def parse(command: str, called: str = "hexapod-gateway") -> dict[str, Any]:
    """Return the arguments of a printed command, as the program reads them. Raises click's UsageError."""
    name, found, *arguments = shlex.split(command.removeprefix("sudo "))
    assert Path(name).absolute() == Path(called).absolute(), command
    group = program()
    while hasattr(group.commands[found], "commands"):
        group, (found, *arguments) = group.commands[found], arguments
    return dict(group.commands[found].make_context(found, arguments).params)
