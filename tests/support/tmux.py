"""A real terminal: a tmux server of its own, keys sent to it, its screen read."""

import os
import re
import shlex
import shutil
import subprocess
import time
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

    def __init__(self, folder: Path, program: str, endpoint: str) -> None:
        """One of our programs, with its options, which dials this endpoint."""
        skip_where("" if shutil.which("tmux") else "Debian package missing: tmux")
        self._socket = folder / "tmux"  # a path, so that no server of somebody else's is met
        options = folder / "tmux.conf"
        options.write_text('set -g default-terminal "screen-256color"\n')
        # tmux itself loses an exit status now and then.
        command = shlex.join([*COMMAND, *program.split(), "--connect", endpoint])
        script = f'{command}; echo "{_ENDED} $?"; stty -a; exec cat'
        size = ("-x", "80", "-y", "24")
        self._tmux("-f", str(options), "new-session", "-d", *size, shlex.join(["sh", "-c", script]))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        subprocess.run(["tmux", "-S", self._socket, "kill-server"], capture_output=True, check=False, timeout=LATE_S)

    def press(self, *keys: str) -> None:
        """Press keys: "Space", "r", "C-c"."""
        self._tmux("send-keys", *keys)

    def wait(self, *texts: str, timeout_s: float = LATE_S) -> str:
        """Wait until all of `texts` are on the screen; its words, of which wrapping parts none.

        Raises TimeoutError that shows the screen.
        """
        deadline = time.monotonic() + timeout_s
        while True:
            screen = self._tmux("capture-pane", "-p")
            words = " ".join(screen.split())
            if all(text in words for text in texts):
                return words
            if time.monotonic() > deadline:
                raise TimeoutError(f"waited {timeout_s} s for {texts}; on the screen:\n{screen}")
            time.sleep(POLL_S)

    def wait_for_end(self, timeout_s: float = LATE_S) -> int:
        """Wait until the command ends; its exit status."""
        found = re.search(rf"{_ENDED} (\d+)", self.wait(f"{_ENDED} ", timeout_s=timeout_s))
        assert found is not None
        return int(found[1])

    def _tmux(self, *arguments: str) -> str:
        command = ["tmux", "-u", "-S", str(self._socket), *arguments]
        env = {**os.environ, "LC_ALL": "C.UTF-8"}
        env.pop("TMUX", None)
        return subprocess.run(command, capture_output=True, text=True, check=True, timeout=LATE_S, env=env).stdout
