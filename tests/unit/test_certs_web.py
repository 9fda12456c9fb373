"""The CA that people import into a browser for the console's sake."""

import datetime as dt
import ssl
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import pytest

from gateway import certs
from gateway.certs import authority
from gateway.certs.files import read_key
from tests.support.certs_folder import fault, make_folder

__all__ = ["make_folder"]  # a fixture

WEB_HOSTS: Final = ("robot.local", "192.0.2.7")


@pytest.mark.parametrize("hosts", [WEB_HOSTS, ("robot.local",), ("192.0.2.7",), ("2001:db8::7",)])
@pytest.mark.parametrize("other", ["bank.example", "local", "192.0.2.8", "10.0.0.1", "2001:db8::8", *WEB_HOSTS])
def test_what_people_import_into_a_browser_is_good_for_the_console_only(
    folder: Path, hosts: Sequence[str], other: str
) -> None:
    """With a stolen key, no other site can be impersonated; judged by OpenSSL, in a real handshake."""
    certs.folder.issue(folder, "web", "console", hosts=hosts)
    ca = authority.KeyPair(certs.files.read_certificate(folder / "web-ca.pem"), read_key(folder / "web-ca.key"))
    for host in hosts:
        assert trusted(folder / "web-ca.pem", folder / "web.pem", folder / "web.key", host)
    stolen = authority.make_leaf(ca, "console", "stolen", [other], 10, dt.datetime.now(dt.UTC))
    (folder / "stolen.pem").write_bytes(stolen.certificate_pem())
    (folder / "stolen.key").write_bytes(stolen.key_pem())
    assert trusted(folder / "web-ca.pem", folder / "stolen.pem", folder / "stolen.key", other) == (other in hosts)


def test_a_console_is_renewed_by_its_own_ca_and_for_its_own_hosts(folder: Path) -> None:
    certs.folder.issue(folder, "web", "console", hosts=WEB_HOSTS)
    certs.folder.renew(folder, "web")
    assert trusted(folder / "web-ca.pem", folder / "web.pem", folder / "web.key", "robot.local")
    assert not trusted(folder / "ca.pem", folder / "web.pem", folder / "web.key", "robot.local")
    assert "keeps its own" in fault(lambda: certs.folder.renew(folder, "web", hosts=["192.0.2.8"]))


def trusted(authority_file: Path, certificate: Path, key: Path, host: str) -> bool:
    """Whether a client that trusts that authority takes the certificate for that host."""
    server = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    server.load_cert_chain(certificate, key)
    to_server, to_client = ssl.MemoryBIO(), ssl.MemoryBIO()
    client = ssl.create_default_context(cafile=authority_file)
    ends = [
        client.wrap_bio(to_client, to_server, server_hostname=host),
        server.wrap_bio(to_server, to_client, server_side=True),
    ]
    for _ in range(4):
        for end in ends:
            try:
                end.do_handshake()
            except ssl.SSLWantReadError:
                continue
            except ssl.SSLCertVerificationError:
                return False
    return True
