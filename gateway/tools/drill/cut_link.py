"""A TCP link to the gateway that the drill can cut: what is on its way waits, as behind a Wi-Fi that is gone."""

import select
import socket
import threading
from contextlib import suppress
from types import TracebackType
from typing import Final, Self

_CHUNK: Final = 65536


class CutLink:
    """Forwards between a client, which connects to `endpoint`, and the gateway, as long as it is not cut."""

    def __init__(self, gateway: str) -> None:
        """`gateway` is its endpoint in plain TCP, such as "tcp/127.0.0.1:7447"."""
        host, _, port = gateway.removeprefix("tcp/").rpartition(":")
        self._gateway = host.strip("[]"), int(port)
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.endpoint = f"tcp/127.0.0.1:{self._listener.getsockname()[1]}"
        self._up = threading.Event()
        self._up.set()
        self._sockets = [self._listener]
        threading.Thread(target=self._accept, name="cut link", daemon=True).start()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for each in self._sockets:
            with suppress(OSError):
                each.shutdown(socket.SHUT_RDWR)
            each.close()
        self._up.set()

    def cut(self) -> None:
        """Nothing passes from now on, in either direction."""
        self._up.clear()

    def fix(self) -> None:
        """What has waited passes, and what comes."""
        self._up.set()

    def _accept(self) -> None:
        with suppress(OSError):  # closed
            while True:
                client, _ = self._listener.accept()
                gateway = socket.create_connection(self._gateway, timeout=5)
                gateway.settimeout(None)
                self._sockets += [client, gateway]
                for source, sink in ((client, gateway), (gateway, client)):
                    threading.Thread(target=self._forward, args=(source, sink), name="cut link", daemon=True).start()

    def _forward(self, source: socket.socket, sink: socket.socket) -> None:
        with suppress(OSError, ValueError):  # closed
            while True:
                select.select([source], [], [])
                self._up.wait()  # before it is read: what was sent just before the cut may have passed, nothing later
                data = source.recv(_CHUNK)
                if not data:
                    sink.shutdown(socket.SHUT_WR)
                    return
                sink.sendall(data)
