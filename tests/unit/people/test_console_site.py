"""Which Host and Origin headers are the console's own, and where it may listen."""

import ssl
from pathlib import Path

import pytest

from gateway import certs
from gateway.errors import ConfigError
from gateway.people.console.server.site import STATE_DIRECTORY, Site, address_of, site
from tests.support.command import parse

HERE = Site("127.0.0.1", 8080, ("127.0.0.1", "localhost"))
TLS = Site("0.0.0.0", 443, ("robot.local", "192.0.2.7", "2001:db8::7"), ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER))  # noqa: S104


@pytest.mark.parametrize(
    ("where", "host"),
    [
        (HERE, None),
        (HERE, ""),
        (HERE, "127.0.0.1"),
        (HERE, "127.0.0.1:80"),
        (HERE, "127.0.0.1:8081"),
        (HERE, "127.0.0.1.evil.example:8080"),
        (HERE, "evil.example:8080"),
        (HERE, "evil@127.0.0.1:8080"),
        (HERE, "0.0.0.0:8080"),
        (HERE, "[::1]:8080"),
        (TLS, "0.0.0.0"),  # noqa: S104
        (TLS, "robot.local:8443"),
        (TLS, "127.0.0.1"),
    ],
)
def test_foreign_hosts(where: Site, host: str | None) -> None:
    assert not where.knows_host(host)
    assert not where.knows_origin(f"{where.scheme}://{host}", host)


@pytest.mark.parametrize(
    "origin",
    [
        None,
        "null",
        "",
        "http://localhost:8080",
        "https://127.0.0.1:8080",
        "http://127.0.0.1:8080/",
        "http://127.0.0.1:80801",
        "http://evil.example",
    ],
)
def test_foreign_origins(origin: str | None) -> None:
    """Another page on this machine is as foreign as any: its origin has another port, scheme or name."""
    assert not HERE.knows_origin(origin, "127.0.0.1:8080")


@pytest.mark.parametrize("listen", ["127.0.0.1:8080", "localhost:1", "[::1]:65535", "127.0.0.5"])
def test_loopback_needs_no_certificate(listen: str) -> None:
    assert site(listen, None, None).scheme == "http"


@pytest.mark.parametrize(
    ("listen", "says"),
    [
        ("0.0.0.0:8080", "needs TLS"),
        ("[::]:8080", "needs TLS"),
        ("192.0.2.7:8080", "needs TLS"),
        ("robot.local:8080", "needs TLS"),
        ("127.0.0.1.example:8080", "needs TLS"),
        ("", "no HOST:PORT"),
        ("8080:", "needs TLS"),
        (":8080", "no HOST:PORT"),
        ("127.0.0.1:0", "no HOST:PORT"),
        ("127.0.0.1:65536", "no HOST:PORT"),
        ("127.0.0.1:http", "no HOST:PORT"),
        ("http://127.0.0.1:8080", "no HOST:PORT"),
        ("me@127.0.0.1:8080", "no HOST:PORT"),
    ],
)
def test_where_it_does_not_listen(listen: str, says: str) -> None:
    with pytest.raises(ConfigError, match=says):
        site(listen, None, None)


def test_a_certificate_without_its_key() -> None:
    with pytest.raises(ConfigError, match="go together"):
        site("0.0.0.0:8080", Path("c.pem"), None)


def test_names_come_from_the_certificate(tmp_path: Path) -> None:
    certs.folder.init(tmp_path, ["robot.local", "192.0.2.7"])
    found = site("0.0.0.0:8443", tmp_path / "gateway.pem", tmp_path / "gateway.key")
    assert found.hosts == ("robot.local", "192.0.2.7")
    assert found.url == "https://robot.local:8443"
    with pytest.raises(ConfigError, match="cannot be used together"):
        site("0.0.0.0:8443", tmp_path / "gateway.pem", tmp_path / "ca.key")
    certs.folder.issue(tmp_path, "anna", "operator")
    with pytest.raises(ConfigError, match="names no host"):
        site("0.0.0.0:8443", tmp_path / "anna.pem", tmp_path / "anna.key")


@pytest.mark.parametrize(
    ("where", "by", "command"),
    [
        (HERE, "", "hexapod-gateway console --link --listen 127.0.0.1:8080"),
        (HERE, str(STATE_DIRECTORY), "sudo hexapod-gateway console --link --listen 127.0.0.1:8080"),
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
