"""What another user of the machine can see of a link into the console, and get of its port."""

import os
import stat
import subprocess
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest

from tests.support.console_process import Console
from tests.support.gateway_process import COMMAND, free_port


@pytest.fixture
def opened(tmp_path: Path) -> Iterator[Console]:
    """Yield a console with a browser that prints its arguments, and no gateway."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    browser = {"BROWSER": "echo opened %s"}
    with Console(tmp_path, "--connect", endpoint, "--open", env=browser) as console:
        yield console


def test_open_shows_no_link_in_the_process_list(opened: Console, tmp_path: Path) -> None:
    """The browser gets the path of a private file, which goes on to the link."""
    said = opened.child.wait_for_output("opened ")
    assert "token" not in said
    file = Path(said.partition("file://")[2].strip())
    assert file.parent == tmp_path
    assert stat.S_IMODE(file.stat().st_mode) == 0o600
    link = file.read_text().partition("url=")[2].partition('"')[0]
    assert httpx.get(link).status_code == 303
    opened.child.terminate()
    assert opened.child.wait() == 0
    assert not file.exists()


def test_a_link_is_printed_to_a_terminal_only(opened: Console) -> None:
    """Not into a journal, which is kept, and which others read."""
    opened.child.wait_for_output("console --link")
    assert "token" not in opened.child.stdout + opened.child.stderr
    assert "token=" in opened.run("--link").stdout
    port = free_port()
    ours, its = os.openpty()
    command = [*COMMAND, "console", "--listen", f"127.0.0.1:{port}", "--connect", f"tcp/127.0.0.1:{free_port()}"]
    with subprocess.Popen(command, env=opened.env, stdin=its, stdout=its, stderr=its) as console:
        os.close(its)
        said = b""
        while b"token=" not in said:
            said += os.read(ours, 1000)
        console.terminate()
    os.close(ours)
