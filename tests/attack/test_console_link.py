"""What another user of the machine can see of a link into the console, and get of its port."""

import hashlib
import os
import signal
import socket
import stat
import subprocess
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest

from gateway.people.console.auth import proof
from tests.support.console_process import Console
from tests.support.gateway_process import COMMAND, free_port


@pytest.fixture
def opened(tmp_path: Path) -> Iterator[Console]:
    """With a browser that prints its arguments, and no gateway."""
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


def test_a_link_that_was_not_used_ends_with_the_console(tmp_path: Path) -> None:
    port, endpoint = free_port(), f"tcp/127.0.0.1:{free_port()}"
    with Console(tmp_path, "--connect", endpoint, port=port) as first:
        unused, session = first.new_link(), first.sign_in()
    with Console(tmp_path, "--connect", endpoint, port=port) as second:
        assert httpx.get(unused).status_code == 403
        assert second.get(**session.headers).status_code == 200, "a restart signs nobody out"


def test_a_port_that_a_socket_unit_keeps_is_never_free_and_who_comes_meanwhile_waits_for_the_console(
    tmp_path: Path,
) -> None:
    """As under systemd, which keeps the socket while it starts the console again."""
    with socket.create_server(("127.0.0.1", 0)) as kept:
        as_systemd = ("bash", "-c", f'LISTEN_FDS=1 LISTEN_PID=$$ exec "$@" 3<&{kept.fileno()}', "bash")

        def started() -> Console:
            return Console(
                tmp_path,
                f"--connect=tcp/127.0.0.1:{free_port()}",
                port=kept.getsockname()[1],
                prefix=as_systemd,
                descriptors=(kept.fileno(),),
            )

        with started() as first:
            session = first.sign_in()
            first.child.send_signal(signal.SIGKILL)
            first.child.wait()
        with socket.socket() as thief:
            thief.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            with pytest.raises(OSError, match="in use"):
                thief.bind(kept.getsockname())
        with socket.create_connection(kept.getsockname()) as page:
            asked = (
                f"GET /session?nonce=mine HTTP/1.1\r\nHost: 127.0.0.1:{first.port}\r\nCookie: {session.cookie}\r\n\r\n"
            )
            page.sendall(asked.encode())
            with started():
                answer = page.makefile("rb").read().decode()
    nonce = answer.partition('"nonce": "')[2].partition('"')[0]
    assert nonce, answer
    assert proof(hashlib.sha256(session.key.encode()).hexdigest(), f"console mine {nonce}") in answer
