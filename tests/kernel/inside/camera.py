"""µStreamer on the kernel's virtual camera (vivid), read as the console reads it."""

import asyncio
import os
import shutil
import signal
import subprocess
import time
from typing import Final

import aiohttp

from gateway.people.watching.camera import Camera, Picture, stream_parts
from tests.kernel.machine import CACHE, LIBRARIES

PORT: Final = 8090
URL: Final = f"http://127.0.0.1:{PORT}/stream?extra_headers=1"
PICTURES: Final = 20
SLOW_S: Final = 120.0
"""For what takes a second where nothing is emulated."""
HANGS_S: Final = 2.0


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
    camera = Camera("front", URL)
    ages_ms, newest = list[float](), None
    for _ in range(PICTURES):
        newest = await _next(camera, newest)
        ages_ms.append((time.monotonic_ns() - newest.taken_ns) / 1e6)
        assert newest.jpeg.startswith(b"\xff\xd8"), newest.jpeg[:4]
    async with aiohttp.ClientSession() as session, session.get(URL) as answer:
        parts = stream_parts(answer.content.readany, answer.headers["content-type"].partition("boundary=")[2])
        for _ in range(PICTURES):
            stated, _ = await anext(parts)
            assert stated["x-ustreamer-online"] == "true", stated.items()
            assert float(stated["x-ustreamer-latency"]) > 0, stated.items()
            assert float(stated["x-timestamp"]) > 0, stated.items()
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
