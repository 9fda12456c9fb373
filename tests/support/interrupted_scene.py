"""A scene that starts whatever tests start, and waits: tests/zenoh/test_interrupted.py interrupts it."""

import os
import shutil
import subprocess
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Final

from tests.box import box
from tests.net import namespaces
from tests.support.child import Child
from tests.support.console_process import Console
from tests.support.gateway_process import Gateway
from tests.support.tmux import Terminal

READY: Final = "SCENE_READY"


def test_never_ends(tmp_path: Path) -> None:
    with ExitStack() as stack:
        gateway = stack.enter_context(Gateway(tmp_path))
        stack.enter_context(Console(tmp_path, "--connect", gateway.endpoint))
        if shutil.which("tmux"):
            stack.enter_context(Terminal(tmp_path, ["sleep", "1000"]))
        if not box.lacks():
            stack.enter_context(box.Box(tmp_path))
        host = () if namespaces.lacks() else stack.enter_context(namespaces.Network(laptops=1)).robot
        stack.enter_context(Child([*host, "sleep", "1000"], {"PATH": os.environ["PATH"]}))
        subprocess.run(["setsid", "--fork", "sleep", "1000"], check=True)  # its parent has ended
        Path(os.environ[READY]).write_text("ready")
        while True:
            time.sleep(1)
