"""Enter, drive, stand, walk and STOP ALL in WebKit, which every iPhone has, and in Firefox."""

from collections.abc import Iterator
from pathlib import Path
from typing import Final

import pytest

from gateway.client import Client
from tests.console.browser import put_to_rest
from tests.console.other_browsers import Firefox, OtherBrowser, WebKit
from tests.support.console_process import Console
from tests.support.gateway_process import Gateway
from tests.support.heard import servos_on, states

pytestmark = [pytest.mark.other_browsers, pytest.mark.nightly]

PAD: Final = "Walk:"
WALKS: Final = "It walks"
PUSHES: Final = 20
"""A busy machine stands still for so long that a page lets go: then its thumb lands anew."""


@pytest.fixture(params=[WebKit, Firefox])
def page(request: pytest.FixtureRequest, tmp_path: Path, gateway: Gateway) -> Iterator[OtherBrowser]:
    """Yield a browser that has opened nothing yet; the robot rests before and after."""
    put_to_rest(gateway)
    with request.param(tmp_path) as running:
        yield running
    put_to_rest(gateway)


def walk(page: OtherBrowser) -> None:
    for _ in range(PUSHES):
        page.push_ahead(PAD)
        page.wait(f'document.body.innerText.includes("{WALKS}") || !document.querySelector("[data-held=yes]")')
        if page.find(f'document.body.innerText.includes("{WALKS}")'):
            return
        page.let_go()
    raise AssertionError(page.find("document.body.innerText"))


def test_enter_drive_stand_walk_and_stop_all(page: OtherBrowser, console: Console, watcher: Client) -> None:
    page.go_to(console.new_link())
    page.wait("document.hasFocus()")
    page.click("Drive")
    page.click("Stand")
    page.wait_for_words("It stands")
    assert watcher.state().mode == "active"
    walk(page)
    before = watcher.state().commands.accepted
    states(watcher).wait(lambda state: state.commands.accepted > before + 20)
    page.let_go()
    page.wait_for_words("It stands")
    walk(page)
    page.let_go()
    page.click("STOP ALL")
    page.wait_for_words("6 Stops written within")
    state = watcher.state()
    assert state.mode == "estopped"
    assert not servos_on(state)
