"""What is written to a disk is written aside, and the owner of the state learns of it."""

import asyncio
import threading
from collections.abc import Callable

import pytest

from gateway.errors import ConfigError
from gateway.robot.host.disk_writer import DiskWriter
from gateway.robot.host.ownership import Ownership


def full() -> None:
    raise ConfigError("the disk is full")


def broken() -> None:
    raise ZeroDivisionError


@pytest.mark.parametrize(("write", "fault"), [(lambda: None, None), (full, "the disk is full")])
async def test_what_became_of_it_is_the_owners(write: Callable[[], None], fault: str | None) -> None:
    state = threading.Lock()
    loop, learned = asyncio.get_running_loop(), asyncio.Future[tuple[str | None, bool]]()

    def then(found: str | None) -> None:
        loop.call_soon_threadsafe(learned.set_result, (found, state.locked()))

    locks = iter((state, threading.Lock()))
    DiskWriter("disk", loop, Ownership(lambda: next(locks))).write(write, then)
    assert await learned == (fault, True)


async def test_a_mistake_of_our_own_ends_the_service() -> None:
    loop, learned = asyncio.get_running_loop(), asyncio.Future[str]()
    loop.set_exception_handler(lambda _, context: learned.set_result(context["message"]))
    disk = DiskWriter("disk", loop, Ownership())
    disk.write(broken, lambda _: None)
    assert await learned == "the thread disk failed"
    again = asyncio.Event()
    disk.write(lambda: None, lambda _: loop.call_soon_threadsafe(again.set))
    await again.wait()
