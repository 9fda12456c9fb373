"""How much one page may have under way, and in which order."""

import asyncio

import pytest

from gateway.people.console.pages.page_tasks import EndError, PageTasks


@pytest.mark.parametrize(("in_turn", "began"), [(True, [1, 1, 2, 2, 3, 3]), (False, [1, 2, 3, 1, 2, 3])])
async def test_a_page_has_so_many_tasks_and_its_end_one_more(in_turn: bool, began: list[int]) -> None:
    """What a page's end requires is never rejected: it releases the lease."""
    tasks, steps, ended = PageTasks(2, "commands", in_turn=in_turn), list[int](), asyncio.Event()

    async def work(number: int) -> None:
        steps.append(number)
        await asyncio.sleep(0)
        steps.append(number)
        if number == 3:
            ended.set()

    for number in (1, 2):
        tasks.check()
        tasks.start(work(number))
    with pytest.raises(EndError, match="2 commands of this page wait for their answers"):
        tasks.check()
    tasks.start(work(3))
    await ended.wait()
    assert steps == began
    await asyncio.sleep(0)
    tasks.check()
