"""A camera's MJPEG server, as µStreamer is one: Python's http.server, with whatever goes wrong in it."""

import base64
import itertools
import threading
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, Final

from tests.support.waiting import Closing

_PLAIN: Final = base64.b64decode(
    "/9j/4AAQSkZJRgABAQAAAQABAAD/2wBDACgcHiMeGSgjISMtKygwPGRBPDc3PHtYXUlkkYCZlo+AjIqgtObDoKrarYqMyP/L2u71"
    "////m8H////6/+b9//j/wAALCAAYACABAREA/8QAFQABAQAAAAAAAAAAAAAAAAAAAAT/xAAUEAEAAAAAAAAAAAAAAAAAAAAA/9oA"
    "CAEBAAA/AJwAAAf/2Q=="
)
"""A grey JPEG of 32 by 24 pixels."""
BOUNDARY: Final = b"\r\n--frame\r\n"
PERIOD_S: Final = 0.02


def jpeg(number: int, size: int = 0) -> bytes:
    """Return a JPEG that differs from those of other numbers, with at least `size` bytes: by comments in it."""
    comments = (size // 60_000 + 1) * [f"{number:08}".encode().ljust(min(size, 60_000))]
    parts = [b"\xff\xfe" + (len(each) + 2).to_bytes(2) + each for each in comments]
    return _PLAIN[:2] + b"".join(parts) + _PLAIN[2:]


def part(data: bytes, **headers: object) -> bytes:
    """Return a part of the stream."""
    lines = {"Content-Type": "image/jpeg", "Content-Length": len(data)}
    lines |= {name.replace("_", "-"): value for name, value in headers.items()}
    return "".join(f"{name}: {value}\r\n" for name, value in lines.items()).encode() + b"\r\n" + data + BOUNDARY


class CameraServer(Closing):
    """Serves pictures 50 times a second at `url`. It is `frozen`, or sends what `answer` writes."""

    def __init__(self, *, size: int = 0) -> None:
        """`size`: the bytes of each picture, at least."""
        self.frozen = threading.Event()
        """Nothing more is sent while it is set; connections stay open."""
        self.answer: Callable[[BaseHTTPRequestHandler], object] | None = None
        self.requests = 0
        self.open = 0
        """Requests that are being answered."""
        self._size = size
        self._ended = threading.Event()
        self._numbers = itertools.count(1)
        server = self

        class Handler(BaseHTTPRequestHandler):
            """One connection."""

            def do_GET(self) -> None:
                server.requests += 1
                server.open += 1
                try:
                    (server.answer or server.stream)(self)
                except OSError:
                    self.close_connection = True
                finally:
                    server.open -= 1

            def log_message(self, *_: Any) -> None:
                """Silent."""

        self._server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self._server.daemon_threads = True
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.05,))
        self._thread.start()
        self.url = f"http://127.0.0.1:{self._server.server_port}/stream"

    def ticks(self) -> Iterator[int]:
        """Yield the numbers of pictures, 50 a second, while it is not frozen."""
        while not self._ended.wait(PERIOD_S):
            if not self.frozen.is_set():
                yield next(self._numbers)

    def stream(self, handler: BaseHTTPRequestHandler) -> None:
        begin(handler)
        for number in self.ticks():
            handler.wfile.write(part(jpeg(number, self._size)))

    def close(self) -> None:
        self._ended.set()
        self._server.shutdown()
        self._thread.join()
        self._server.server_close()


def begin(handler: BaseHTTPRequestHandler, kind: str = "multipart/x-mixed-replace; boundary=frame") -> None:
    handler.send_response(200)
    handler.send_header("Content-Type", kind)
    handler.end_headers()
    handler.wfile.write(BOUNDARY)
