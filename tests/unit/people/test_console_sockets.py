"""Which sockets the console takes from systemd, which it rejects, and that the socket unit alone has the address."""

import os
import socket
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from gateway.errors import ConfigError
from gateway.people.console.server.site import DEAD_MS, address_in, inherited, listening, site
from tests.support.gateway_process import free_port

PID = str(os.getpid())


@pytest.fixture
def stack() -> Iterator[ExitStack]:
    with ExitStack() as stack:
        yield stack


def server(stack: ExitStack, host: str = "127.0.0.1", port: int = 0) -> socket.socket:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    return stack.enter_context(socket.create_server((host, port), family=family))


def taken(passed: socket.socket, number: str = "1", pid: str = PID) -> list[socket.socket]:
    """What is inherited where systemd has put the first socket to the number of this one."""
    found = inherited({"LISTEN_PID": pid, "LISTEN_FDS": number}, first=passed.fileno())
    if found:
        passed.detach()  # which is whose from now on
    return found


def test_a_socket_is_taken_and_no_child_gets_it_or_its_name(stack: ExitStack) -> None:
    passed = server(stack)
    address, number = passed.getsockname(), passed.fileno()
    environment = {"LISTEN_PID": PID, "LISTEN_FDS": "1", "LISTEN_FDNAMES": "console.socket", "HOME": "/"}
    os.set_inheritable(number, True)
    (found,) = inherited(environment, first=passed.detach())
    stack.enter_context(found)
    assert (found.fileno(), found.getsockname()) == (number, address)
    assert not os.get_inheritable(number)
    assert environment == {"HOME": "/"}
    with listening(site(address_in([found], None), None, None), [found]) as used:
        assert used == [found]
        assert found.getsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT) == DEAD_MS
        socket.create_connection(address).close()


@pytest.mark.parametrize("pid", ["", "1", PID + "0", "all"], ids=["none", "init", "another", "no number"])
def test_without_sockets_of_its_own_it_binds_by_itself(stack: ExitStack, pid: str) -> None:
    passed = server(stack)
    assert taken(passed, pid=pid) == []
    assert inherited({}) == []
    with listening(site(f"127.0.0.1:{free_port()}", None, None)) as used:
        assert [each.getsockname()[0] for each in used] == ["127.0.0.1"]


@pytest.mark.parametrize(
    ("family", "kind", "listens"),
    [
        (socket.AF_UNIX, socket.SOCK_STREAM, True),
        (socket.AF_INET, socket.SOCK_DGRAM, False),
        (socket.AF_INET, socket.SOCK_STREAM, False),
    ],
)
def test_another_kind_of_socket_is_rejected(
    stack: ExitStack, family: socket.AddressFamily, kind: socket.SocketKind, listens: bool
) -> None:
    passed = stack.enter_context(socket.socket(family, kind))
    if listens:
        passed.bind("")
        passed.listen()
    with pytest.raises(ConfigError, match="is no TCP socket that listens"):
        taken(passed)


def test_a_descriptor_that_is_no_socket_is_rejected() -> None:
    with Path(os.devnull).open() as file, pytest.raises(ConfigError, match="is no TCP socket that listens"):
        inherited({"LISTEN_PID": PID, "LISTEN_FDS": "1"}, first=file.fileno())


@pytest.mark.parametrize("listen", ["127.0.0.1:1", "127.0.0.2:{}", "localhost:{}", "0.0.0.0:{}", "[::1]:{}"])
def test_another_address_in_the_options_is_rejected(stack: ExitStack, listen: str) -> None:
    """Else the unit's port would be answered by nobody."""
    passed = server(stack)
    with pytest.raises(ConfigError, match=r"^--listen .* is not where hexapod-console.socket listens \(127.0.0.1:"):
        address_in([passed], listen.format(passed.getsockname()[1]))


@pytest.mark.parametrize("number", [2, 3])
def test_more_addresses_than_localhosts_are_rejected(stack: ExitStack, number: int) -> None:
    with pytest.raises(ConfigError, match=f"has {number} addresses"):
        address_in([server(stack) for _ in range(number)], None)
