"""A real terminal: a tmux server of its own, keys sent to it, its screen read."""

import os
import re
import shlex
import shutil
import subprocess
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final, Self

from tests.support.gateway_process import COMMAND
from tests.support.lacks import skip_where

POLL_S: Final = 0.05
LATE_S: Final = 30.0
"""For what takes milliseconds on a machine that is not busy."""


_ENDED: Final = "ended with status"


class Terminal:
    """One command in a terminal of 80 columns and 24 rows; after it, `stty -a` says how it left the terminal.

    Without tmux the test is skipped or, in CI, fails in one line that names the package.
    """

    def __init__(self, folder: Path, command: Sequence[str], *, columns: int = 80, rows: int = 24) -> None:
        skip_where("" if shutil.which("tmux") else "Debian package missing: tmux")
        self._socket = folder / "tmux"  # a path, so that no server of somebody else's is met
        options = folder / "tmux.conf"
        options.write_text('set -g default-terminal "screen-256color"\n')
        # tmux itself loses an exit status now and then.
        script = f'{shlex.join(command)}; echo "{_ENDED} $?"; stty -a; exec cat'
        size = ("-x", str(columns), "-y", str(rows))
        self._tmux("-f", str(options), "new-session", "-d", *size, shlex.join(["sh", "-c", script]))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        subprocess.run(["tmux", "-S", self._socket, "kill-server"], capture_output=True, check=False, timeout=LATE_S)

    def press(self, *keys: str) -> None:
        """Press keys: "Space", "r", "C-c"."""
        self._tmux("send-keys", *keys)

    @property
    def pid(self) -> int:
        """The command's process."""
        shell = self._tmux("display-message", "-p", "#{pane_pid}").strip()
        return int(Path(f"/proc/{shell}/task/{shell}/children").read_text().split()[0])

    def close(self) -> None:
        """Close the window, as a person does."""
        self._tmux("kill-session")

    @property
    def screen(self) -> str:
        return self._tmux("capture-pane", "-p")

    @property
    def words(self) -> str:
        """The screen with each run of blanks and line ends as one blank, so that wrapping does not matter."""
        return _words(self.screen)

    @property
    def status(self) -> int | None:
        """The command's exit status, None while it runs."""
        found = re.search(rf"{_ENDED} (\d+)", self.words)
        return int(found[1]) if found else None

    def wait(self, *texts: str, timeout_s: float = LATE_S) -> str:
        """Wait until all of `texts` are on the screen; its words."""
        return self.wait_until(lambda words: all(text in words for text in texts), f"{texts}", timeout_s)

    def wait_until(self, holds: Callable[[str], bool], what: str, timeout_s: float = LATE_S) -> str:
        """Wait until `holds` for the screen's words. Raises TimeoutError that shows the screen."""
        screen = self.wait_for_screen(lambda screen: holds(_words(screen)), what, timeout_s)
        return _words(screen)

    def wait_for_screen(self, holds: Callable[[str], bool], what: str, timeout_s: float = LATE_S) -> str:
        """The same for the screen, line by line: all of one picture is looked at, while the next may come."""
        deadline = time.monotonic() + timeout_s
        while not holds(screen := self.screen):
            if time.monotonic() > deadline:
                raise TimeoutError(f"waited {timeout_s} s for {what}; on the screen:\n{screen}")
            time.sleep(POLL_S)
        return screen

    def wait_for_end(self, timeout_s: float = LATE_S) -> int:
        """Wait until the command ends; its exit status."""
        self.wait_until(lambda _: self.status is not None, "its end", timeout_s)
        assert self.status is not None
        return self.status

    def _tmux(self, *arguments: str) -> str:
        command = ["tmux", "-u", "-S", str(self._socket), *arguments]
        env = {**os.environ, "LC_ALL": "C.UTF-8"}
        env.pop("TMUX", None)
        return subprocess.run(command, capture_output=True, text=True, check=True, timeout=LATE_S, env=env).stdout


def at_terminal(folder: Path, program: str, endpoint: str, *, columns: int = 80, rows: int = 24) -> Terminal:
    """One of our programs, with its options, which dials this endpoint."""
    return Terminal(folder, [*COMMAND, *program.split(), "--connect", endpoint], columns=columns, rows=rows)


def _words(screen: str) -> str:
    return " ".join(screen.split())
