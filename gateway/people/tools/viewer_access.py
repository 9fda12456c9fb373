"""In front of the viewers' server: lets in viewers, and no other web page.

The server of the Foxglove SDK asks nobody for `Origin`, and a page reaches every port of the machine. So it speaks TLS
with a certificate that no browser knows, and what is let in here is handed to it.
"""

import asyncio
import datetime as dt
import ssl
import threading
from collections.abc import Collection
from contextlib import suppress
from http.client import HTTPException, parse_headers
from io import BytesIO
from typing import Final

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import NameOID

from gateway.web_hosts import LOOPBACK, may_ask

VIEWERS: Final = ("https://app.foxglove.dev", "file://")
"""Foxglove in a browser, and programs made of a browser (Electron), whose pages come from files."""
_MOST_BYTES: Final = 8192
_REQUEST_S: Final = 5.0
_PIECE: Final = 65_536
_REJECTED: Final = b"HTTP/1.1 403 Forbidden\r\nConnection: close\r\nContent-Length: 0\r\n\r\n"


class Pair:
    """A certificate and its key in PEM, for this process alone."""

    def __init__(self, host: str) -> None:
        """`host`: its name."""
        key, now = ec.generate_private_key(ec.SECP256R1()), dt.datetime.now(dt.UTC)
        name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, host)])
        made = (
            x509.CertificateBuilder(name, name, key.public_key(), x509.random_serial_number())
            .not_valid_before(now - dt.timedelta(days=1))
            .not_valid_after(now + dt.timedelta(days=3650))
            .add_extension(x509.SubjectAlternativeName([x509.DNSName(host)]), critical=False)
            .sign(key, hashes.SHA256())
        )
        self.certificate = made.public_bytes(serialization.Encoding.PEM)
        self.key = key.private_bytes(
            serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
        )


class Door:
    """Listens at once, and serves from a thread of its own until `close`. Raises OSError."""

    def __init__(self, host: str, port: int, origins: Collection[str]) -> None:
        """`origins`: of further pages that may look."""
        self._origins = {*VIEWERS, *origins}
        self._loop = asyncio.new_event_loop()
        try:
            server = self._loop.run_until_complete(asyncio.start_server(self._serve, host, port, limit=_MOST_BYTES))
        except OSError:
            self._loop.close()
            raise
        self._host = host
        self.port = int(server.sockets[0].getsockname()[1])
        self._thread = threading.Thread(target=self._loop.run_forever, name="viewers", daemon=True)

    def open(self, behind: int, name: str, certificate: bytes) -> None:
        """Begin: whoever is let in is handed to the server at this port, which has that certificate."""
        self._behind, self._name = behind, name
        self._trust = ssl.create_default_context(cadata=certificate.decode())
        self._thread.start()

    def close(self) -> None:
        """Connections end with it."""
        if self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._loop.stop)
            self._thread.join()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with suppress(OSError, EOFError, TimeoutError, asyncio.LimitOverrunError):
            try:
                head = await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), _REQUEST_S)
                if not self._lets_in(head):
                    writer.write(_REJECTED)
                    await writer.drain()
                    return
                inner, outer = await asyncio.open_connection(
                    self._host, self._behind, ssl=self._trust, server_hostname=self._name
                )
                outer.write(head)
                await asyncio.gather(_pass_on(reader, outer), _pass_on(inner, writer))
            finally:
                writer.close()

    def _lets_in(self, head: bytes) -> bool:
        try:
            headers = parse_headers(BytesIO(head.partition(b"\r\n")[2]))
        except HTTPException:
            return False
        hosts, origins = headers.get_all("Host", []), headers.get_all("Origin", [])
        if len(hosts) != 1 or len(origins) > 1:
            return False
        return may_ask(hosts[0], origins[0] if origins else None, LOOPBACK, self._origins)


async def _pass_on(source: asyncio.StreamReader, target: asyncio.StreamWriter) -> None:
    """Until the source ends; the other direction ends with it."""
    with suppress(OSError):
        try:
            while data := await source.read(_PIECE):
                target.write(data)
                await target.drain()
        finally:
            target.close()
