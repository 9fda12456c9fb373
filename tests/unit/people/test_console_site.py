"""How browsers reach the console: hosts, origins, certificates, and a page without a line that its policy forbids."""

import os
import re
import socket
import ssl
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from hashlib import sha256
from pathlib import Path
from typing import Final

import pytest
from aiohttp import web
from multidict import CIMultiDict
from yarl import URL

from gateway import certs
from gateway.errors import ConfigError
from gateway.host.directories import CONSOLE_STATE
from gateway.people.console import ConsoleOptions
from gateway.people.console.phone import explain, prepared
from gateway.people.console.server.auth import read_files
from gateway.people.console.server.site import (
    RECEIVED_BYTES,
    Site,
    address_in,
    address_of,
    inherited,
    listening,
    site,
)
from tests.support.command import parse
from tests.support.gateway_process import free_port

HERE = Site("127.0.0.1", 8080, ("127.0.0.1", "localhost"))
TLS = Site("0.0.0.0", 443, ("robot.local", "192.0.2.7", "2001:db8::7"), ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER))  # noqa: S104


@pytest.mark.parametrize(
    ("where", "host"),
    [
        (HERE, None),
        (HERE, ""),
        (HERE, "127.0.0.1"),
        (HERE, "127.0.0.1.evil.example:8080"),
        (HERE, "localhost.evil.example:8081"),
        (HERE, "robot.example"),
        (HERE, "[::1:8081"),
        (HERE, "localhost:"),
        (TLS, "0.0.0.0"),  # noqa: S104
        (TLS, "robot.local:8443"),
        (TLS, "localhost:443"),
        (TLS, "127.0.0.1:8443"),
        (HERE, "127.0.0.2:8080"),
        (HERE, "[::ffff:127.0.0.1]:8080"),
        (HERE, "localhost.:8080"),
        (HERE, "evil.example@127.0.0.1:8080"),
        (HERE, "127.0.0.1:8080, evil.example"),
    ],
)
def test_foreign_hosts(where: Site, host: str | None) -> None:
    assert not where.knows_host(host)


CERTIFIED = Site("127.0.0.1", 8443, ("robot.local", "localhost"), TLS.tls)
PROXIED = site("127.0.0.1:8080", None, None, ("Robot.example",))


@pytest.mark.parametrize(
    ("where", "host", "origin"),
    [
        (HERE, "127.0.0.1:8081", "http://127.0.0.1:8081"),
        (HERE, "localhost:9000", "http://localhost:9000"),
        (HERE, "[::1]:8081", "http://[::1]:8081"),
        (CERTIFIED, "localhost:8081", "https://localhost:8081"),
        (PROXIED, "robot.example", "https://robot.example"),
        (PROXIED, "ROBOT.example:8443", "https://ROBOT.example:8443"),
        (PROXIED, "robot.example", "http://robot.example"),
    ],
)
def test_a_tunnel_comes_from_loopback_at_any_port_and_a_proxy_by_an_admitted_name(
    where: Site, host: str, origin: str
) -> None:
    assert where.knows_host(host)
    assert where.is_own(origin, host)
    for other in ("http://localhost:8080", "https://evil.example", None, "null"):
        assert not where.is_own(other, host)


@pytest.mark.parametrize("name", ["https://robot.example", "robot.example:8080", "robot.example/x", "", "a b"])
def test_what_is_no_name_is_not_admitted(name: str) -> None:
    with pytest.raises(ConfigError, match="is no name of a host"):
        site("127.0.0.1:8080", None, None, (name,))


@pytest.mark.parametrize("listen", ["127.0.0.1:8080", "localhost:1", "[::1]:65535", "127.0.0.5"])
def test_loopback_needs_no_certificate(listen: str) -> None:
    assert site(listen, None, None).scheme == "http"


@pytest.mark.parametrize(
    ("listen", "says"),
    [
        ("0.0.0.0:8080", "needs TLS"),
        ("127.0.0.1.example:8080", "needs TLS"),
        ("", "no HOST:PORT"),
        ("127.0.0.1:0", "no HOST:PORT"),
        ("127.0.0.1:65536", "no HOST:PORT"),
        ("me@127.0.0.1:8080", "no HOST:PORT"),
    ],
)
def test_where_it_does_not_listen(listen: str, says: str) -> None:
    with pytest.raises(ConfigError, match=says):
        site(listen, None, None)


def test_names_come_from_the_certificate(tmp_path: Path) -> None:
    certs.folder.init(tmp_path, ["robot.local", "192.0.2.7"])
    found = site("0.0.0.0:8443", tmp_path / "gateway.pem", tmp_path / "gateway.key")
    assert found.hosts == ("robot.local", "192.0.2.7")
    assert found.url == "https://robot.local:8443"
    with pytest.raises(ConfigError, match="cannot be used together"):
        site("0.0.0.0:8443", tmp_path / "gateway.pem", tmp_path / "ca.key")
    with pytest.raises(ConfigError, match="go together"):
        site("0.0.0.0:8443", tmp_path / "gateway.pem", None)
    certs.folder.issue(tmp_path, "anna", "operator")
    with pytest.raises(ConfigError, match="names no host"):
        site("0.0.0.0:8443", tmp_path / "anna.pem", tmp_path / "anna.key")


@pytest.mark.parametrize(
    ("where", "by", "command"),
    [
        (HERE, "", "hexapod-gateway console --link --listen 127.0.0.1:8080"),
        (HERE, str(CONSOLE_STATE), "sudo hexapod-gateway console --link --listen 127.0.0.1:8080"),
        (Site("::1", 8081, ("::1",)), "", "hexapod-gateway console --link --listen '[::1]:8081'"),
    ],
    ids=["a user's", "the service's", "IPv6"],
)
def test_the_command_for_a_link_reaches_this_console(
    where: Site, by: str, command: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("STATE_DIRECTORY", by)
    assert where.link_command == command
    assert address_of(parse(command)["listen"]) == (where.address, where.port)


# ---- sockets from systemd


PID = str(os.getpid())


@pytest.fixture
def stack() -> Iterator[ExitStack]:
    with ExitStack() as stack:
        yield stack


def server(stack: ExitStack) -> socket.socket:
    return stack.enter_context(socket.create_server(("127.0.0.1", 0)))


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
        assert found.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) == 2 * RECEIVED_BYTES  # as Linux counts
        socket.create_connection(address).close()


@pytest.mark.parametrize("pid", ["", "1", PID + "0", "all"], ids=["none", "init", "another", "no number"])
def test_without_sockets_of_its_own_it_binds_by_itself(stack: ExitStack, pid: str) -> None:
    assert inherited({"LISTEN_PID": pid, "LISTEN_FDS": "1"}, first=server(stack).fileno()) == []
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
        inherited({"LISTEN_PID": PID, "LISTEN_FDS": "1"}, first=passed.fileno())


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


LISTEN = "192.0.2.7:8443"


def prepare(folder: Path, listen: str = LISTEN) -> ConsoleOptions:
    return prepared(ConsoleOptions(listen, phone=True), folder)


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))


def test_a_certificate_for_the_address_is_made_once_and_its_key_stays_private(tmp_path: Path) -> None:
    first = prepare(tmp_path)
    assert first.cert is not None
    made = first.cert.read_bytes()
    assert first.cert.stat().st_mode & 0o777 == 0o600
    assert site(LISTEN, first.cert, first.key).url == "https://192.0.2.7:8443"
    ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER).load_cert_chain(first.cert, first.key)
    assert prepare(tmp_path) == first
    assert first.cert.read_bytes() == made, "a phone that has accepted it is not asked again"
    assert prepare(tmp_path, "192.0.2.8:8443").cert == first.cert
    assert first.cert.read_bytes() != made, "at another address"


@pytest.mark.parametrize(("hosts", "uses"), [(["192.0.2.7", "robot.local"], True), (["robot.local"], False)])
def test_the_fleets_certificate_is_used_where_it_fits(tmp_path: Path, hosts: Sequence[str], uses: bool) -> None:
    fleet = tmp_path / "hexapod-certs"
    certs.folder.init(fleet, ["robot.local"])
    certs.folder.issue(fleet, "web", "console", hosts=hosts)
    found = prepare(tmp_path)
    assert (found.cert == fleet / "web.pem", found.key == fleet / "web.key") == (uses, uses)


@pytest.mark.parametrize(("target", "status"), [("/", 200), ("/tap.js", 200), ("/../phone.pem", 404), ("/ws", 404)])
async def test_the_page_without_tls_answers_with_its_own_files_only(target: str, status: int) -> None:
    answer = await explain(URL(target), CIMultiDict({"Host": "192.0.2.7:8080"}))
    assert isinstance(answer, web.Response)
    assert answer.status == status
    assert answer.keep_alive is False
    assert "default-src 'none'" in answer.headers["content-security-policy"]


PAGE: Final = Path(__file__).parents[3] / "gateway/people/console/page"
HTML: Final = (PAGE / "index.html").read_text()
BUTTON: Final = (PAGE / "button.html").read_text()
"""The page that is a stop button."""
MODULES: Final = sorted(PAGE.glob("*.js"))

THREE_0_187_0: Final = "d12e651b7b45cc9a16d5bebd26301664597b376c2a1e3002cbf3a65f69fab5be"
"""SHA-256 of what `make three` makes of npm's package three 0.187.0."""


def test_every_file_that_the_page_names_is_there() -> None:
    named = re.findall(r'(?:src|href)="([^"./][^"]+)"', HTML + BUTTON)
    assert {"main.js", "button.js", "button.css"} <= {*named}
    named.remove("button")  # a page of its own
    for module in MODULES:
        imports = re.findall(r'(?:from|import\() ?"(\.[^"]+)"', module.read_text())
        named += [f"{module.parent.relative_to(PAGE)}/{path}" for path in imports]
    for path in named:
        assert (PAGE / path).is_file(), path


def test_nothing_in_the_page_is_inline_or_from_elsewhere() -> None:
    assert not re.search(r"<script(?![^>]* src=)|<style|\sstyle=|\son\w+=", HTML + BUTTON)
    for text in (HTML, BUTTON, *(module.read_text() for module in MODULES)):
        assert not [address for address in re.findall(r"\bhttps?://[^\s\"']+", text) if "www.w3.org" not in address]


@pytest.mark.parametrize("module", MODULES, ids=lambda module: module.name)
def test_every_element_that_a_module_wants_is_on_the_page(module: Path) -> None:
    for name in re.findall(r'byId\("([^"]+)"', module.read_text()):
        assert f'id="{name}"' in (BUTTON if module.name == "button.js" else HTML), name


def test_three_is_as_it_was_made_with_its_licence_and_has_what_the_page_uses() -> None:
    vendor = PAGE / "vendor" / "three"
    assert "MIT License" in (vendor / "LICENSE").read_text()
    made = (vendor / "three.js").read_bytes()
    assert sha256(made).hexdigest() == THREE_0_187_0, "make three"
    exported = set(re.findall(r" as (\w+)[,}]", made.decode().rpartition("export{")[2]))
    used = {name for module in MODULES for name in re.findall(r"\bthree\.([A-Z]\w+)", module.read_text())}
    assert exported == used, "make three"


def test_a_phone_loads_at_most_300_kb() -> None:
    """All files, the 3D part too, packed; headers come on top."""
    answers = [file.response(CIMultiDict({"Accept-Encoding": "gzip"})) for file in read_files().values()]
    assert sum(len(answer.body) for answer in answers if isinstance(answer.body, bytes)) in range(100_000, 300_000)
