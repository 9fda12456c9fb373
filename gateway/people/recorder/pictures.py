"""Cameras' pictures for a recording: fetched in a thread of its own, and queued with the reports."""

import asyncio
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Final

from gateway.people.terminal import hint
from gateway.people.watching.camera import Camera, Picture

LOOK_S: Final = 0.1
"""The longest wait for the thread's end."""


@contextmanager
def fetched(found: Mapping[str, Camera], put: Callable[[str, bytes, int], None]) -> Iterator[None]:
    """Call `put` with each camera's name, JPEG and its time within the block. A camera's trouble is printed."""
    ended = threading.Event()

    async def follow(camera: Camera) -> None:
        newest: Picture | None = None
        trouble = ""
        while not ended.is_set():
            if (newer := await camera.newer(newest, LOOK_S)) is not None:
                newest = newer
                put(camera.name, *newer)
            if camera.trouble != trouble:
                trouble = camera.trouble
                hint(trouble or f"The camera {camera.name} sends pictures again.")

    async def follow_all() -> None:
        await asyncio.gather(*map(follow, found.values()))

    thread = threading.Thread(target=asyncio.run, args=(follow_all(),), name="cameras", daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()
