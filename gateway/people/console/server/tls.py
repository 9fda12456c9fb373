"""TLS of one connection, without I/O: takes received bytes, and returns the bytes to send.

So a connection can move to another thread between two calls, with its socket, its TLS and its protocol's state.
asyncio's own TLS is bound to the loop on which it began.
"""

import ssl
from pathlib import Path
from typing import Final

RECORD_BYTES: Final = 16_384
"""TLS's largest record, decrypted in one step."""


class Layer:
    """Between a socket and HTTP, without TLS: changes nothing."""

    def receive(self, data: bytes) -> bytes:
        """The content of received bytes. Raises EOFError once the other side has closed, ssl.SSLError."""
        return data

    def encrypt(self, data: bytes) -> bytes:
        """The bytes by which the other side receives `data`. Raises ssl.SSLError."""
        return data

    def to_send(self) -> bytes:
        """Further bytes to send: of the handshake, and alerts."""
        return b""


class Tls(Layer):
    """The server's side of one TLS connection."""

    def __init__(self, context: ssl.SSLContext) -> None:
        self._incoming, self._outgoing = ssl.MemoryBIO(), ssl.MemoryBIO()
        self._connection = context.wrap_bio(self._incoming, self._outgoing, server_side=True)
        self._is_open = False

    def receive(self, data: bytes) -> bytes:
        self._incoming.write(data)
        received = bytearray()
        try:
            if not self._is_open:
                self._connection.do_handshake()
                self._is_open = True
            while part := self._connection.read(RECORD_BYTES):
                received += part
        except ssl.SSLWantReadError:
            return bytes(received)
        except ssl.SSLZeroReturnError as error:
            raise EOFError from error
        raise EOFError

    def encrypt(self, data: bytes) -> bytes:
        self._connection.write(data)
        return self._outgoing.read()

    def to_send(self) -> bytes:
        return self._outgoing.read()


def server_context(certificate: Path, key: Path) -> ssl.SSLContext:
    """TLS 1.2 or newer, with this certificate and key. Raises OSError, ssl.SSLError."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    context.options |= ssl.OP_NO_RENEGOTIATION  # in TLS 1.2 a client could demand handshakes without end
    context.load_cert_chain(certificate, key)
    return context
