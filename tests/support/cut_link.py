"""A link to the gateway that a test can cut or slow: bytes on their way wait, as in a Wi-Fi without reception.

It forwards bytes and not TLS, so both ends verify each other's certificate.
"""

import math
import select
import socket
import threading
import time
from contextlib import suppress
from queue import SimpleQueue
from typing import Final

from tests.support.waiting import Closing

_CHUNK: Final = 65536


class CutLink(Closing):
    """Forwards between a client, which connects to `endpoint`, and the gateway, while it is not cut."""

    def __init__(self, gateway: str, delay_s: float = 0.0, bits_a_second: float = math.inf) -> None:
        """`gateway` is its endpoint over TCP, such as "tcp/127.0.0.1:7447" or "tls/192.0.2.7:7447".

        `delay_s`: how long everything is on its way, in either direction. `bits_a_second`: of all connections together.
        """
        self._s_a_byte = 8 / bits_a_second
        self._free_s = [0.0, 0.0]
        """When each direction has sent what it has taken."""
        self._delay_s = delay_s
        protocol, _, address = gateway.partition("/")
        host, _, port = address.rpartition(":")
        self._gateway = host.strip("[]"), int(port)
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.endpoint = f"{protocol}/127.0.0.1:{self._listener.getsockname()[1]}"
        self._to_gateway, self._to_client = threading.Event(), threading.Event()
        self.fix()
        self._sockets = [self._listener]
        threading.Thread(target=self._accept, name="cut link", daemon=True).start()

    def close(self) -> None:
        """End it permanently; pending bytes are lost."""
        for each in self._sockets:
            with suppress(OSError):
                each.shutdown(socket.SHUT_RDWR)
            each.close()
        self.fix()

    def cut(self) -> None:
        """Let nothing pass from now on, in either direction."""
        self._to_gateway.clear()
        self._to_client.clear()

    def hold(self) -> None:
        """Hold back what the client sends from now on. What the gateway sends still arrives."""
        self._to_gateway.clear()

    def fix(self) -> None:
        """Let everything pass, beginning with what has waited."""
        self._to_gateway.set()
        self._to_client.set()

    def _accept(self) -> None:
        with suppress(OSError):  # closed
            while True:
                client, _ = self._listener.accept()
                gateway = socket.create_connection(self._gateway, timeout=5)
                gateway.settimeout(None)
                self._sockets += [client, gateway]
                for way in ((client, gateway, self._to_gateway, 0), (gateway, client, self._to_client, 1)):
                    threading.Thread(target=self._forward, args=way, name="cut link", daemon=True).start()

    def _forward(self, source: socket.socket, sink: socket.socket, up: threading.Event, way: int) -> None:
        on_its_way: SimpleQueue[tuple[float, bytes]] = SimpleQueue()
        threading.Thread(target=self._deliver, args=(on_its_way, sink), name="cut link", daemon=True).start()
        data = b"-"
        with suppress(OSError, ValueError):  # closed
            while data:
                select.select([source], [], [])
                up.wait()  # before it is read: what was sent just before the cut may have passed, nothing later
                data = source.recv(_CHUNK)
                self._free_s[way] = max(self._free_s[way], time.monotonic()) + len(data) * self._s_a_byte
                on_its_way.put((self._free_s[way] + self._delay_s, data))

    def _deliver(self, on_its_way: SimpleQueue[tuple[float, bytes]], sink: socket.socket) -> None:
        with suppress(OSError):  # closed
            while True:
                due_s, data = on_its_way.get()
                time.sleep(max(0.0, due_s - time.monotonic()))
                if not data:
                    sink.shutdown(socket.SHUT_WR)
                    return
                sink.sendall(data)
