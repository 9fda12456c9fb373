"""What is written to a disk is written aside, and the owner of the state learns of it."""

import asyncio

from gateway.robot.host.disk_writer import DiskWriter
from gateway.robot.host.ownership import Ownership


def broken() -> None:
    raise ZeroDivisionError


async def test_a_mistake_of_our_own_ends_the_service() -> None:
    loop, learned = asyncio.get_running_loop(), asyncio.Future[str]()
    loop.set_exception_handler(lambda _, context: learned.set_result(context["message"]))
    disk = DiskWriter("disk", loop, Ownership())
    disk.write(broken, lambda _: None)
    assert await learned == "the thread disk failed"
    again = asyncio.Event()
    disk.write(lambda: None, lambda _: loop.call_soon_threadsafe(again.set))
    await again.wait()
