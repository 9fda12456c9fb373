"""TLS of one connection, without I/O: what came goes in, what is to be sent comes out.

So a connection can go from one thread to another between two calls, with all that it has: its socket, this, and the
state of its protocol. asyncio's own TLS is bound to the loop that it began on.
"""

import ssl
from pathlib import Path
from typing import Final

RECORD_BYTES: Final = 16_384
"""The largest record of TLS; as much is decrypted in one step."""


class Layer:
    """What is between a socket and HTTP. This one is no TLS, and changes nothing."""

    def receive(self, data: bytes) -> bytes:
        """Take what came, and return its content. Raises EOFError once the other side has closed, ssl.SSLError."""
        return data

    def encrypt(self, data: bytes) -> bytes:
        """What to send so that the other side receives `data`. Raises ssl.SSLError."""
        return data

    def to_send(self) -> bytes:
        """What is to be sent besides: answers of the handshake, alerts."""
        return b""


class Tls(Layer):
    """The server's side."""

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
    """For a console with these files. Raises OSError, ssl.SSLError."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    context.options |= ssl.OP_NO_RENEGOTIATION  # with TLS 1.2 a client could make the server compute again and again
    context.load_cert_chain(certificate, key)
    return context
