"""µStreamer on the kernel's virtual camera (vivid), read as the console reads it."""

import asyncio
import os
import shutil
import signal
import subprocess
import time
from email.message import Message
from typing import Final

from yarl import URL

from gateway.people.watching.camera import Camera, Picture
from tests.kernel.parts import CACHE, LIBRARIES

PORT: Final = 8090
PICTURES: Final = 20
SLOW_S: Final = 120.0
"""For what takes a second where nothing is emulated."""
HANGS_S: Final = 2.0


class Noted(Camera):
    """A camera whose newest headers are kept."""

    headers: Message

    async def _take(self, headers: Message, jpeg: bytes, taken_ns: int) -> None:
        self.headers = headers
        await super()._take(headers, jpeg, taken_ns)


def streams() -> str:
    """Read pictures, with what µStreamer states of each; then it hangs, and goes on."""
    root = CACHE / "root"
    program = shutil.which("ustreamer") or str(root / "usr/bin/ustreamer")
    libraries = ":".join(str(root / each) for each in LIBRARIES)
    command = [program, "--device", "/dev/video0", "--resolution", "640x360", "--port", str(PORT), "--tcp-nodelay"]
    with subprocess.Popen(command, env={**os.environ, "LD_LIBRARY_PATH": libraries}) as child:
        try:
            return asyncio.run(_read(child))
        finally:
            child.kill()


async def _read(child: subprocess.Popen[bytes]) -> str:
    camera = Noted("front", URL(f"http://127.0.0.1:{PORT}/stream?extra_headers=1"))
    ages_ms, newest = list[float](), None
    for _ in range(PICTURES):
        newest = await _next(camera, newest)
        ages_ms.append((time.monotonic_ns() - newest.taken_ns) / 1e6)
        stated = camera.headers
        assert stated["x-ustreamer-online"] == "true", stated
        assert float(stated["x-ustreamer-latency"]) > 0, stated
        assert float(stated["x-timestamp"]) > 0, stated
        assert newest.jpeg.startswith(b"\xff\xd8"), newest.jpeg[:4]
    child.send_signal(signal.SIGSTOP)
    while (hung := await camera.newer(newest, HANGS_S)) is not None:  # those on their way
        newest = hung
    child.send_signal(signal.SIGCONT)
    await _next(camera, newest)
    ages_ms.sort()
    return f"{PICTURES} pictures, {ages_ms[PICTURES // 2]:.0f} ms old (p50), {ages_ms[-1]:.0f} ms at most"


async def _next(camera: Camera, than: Picture | None) -> Picture:
    found = await camera.newer(than, SLOW_S)
    assert found is not None, camera.trouble or "no picture"
    return found
