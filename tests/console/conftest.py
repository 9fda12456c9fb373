"""One Chromium for all tests of the console's page; where it is missing they are skipped, but fail in CI."""

import inspect
from collections.abc import Iterator
from typing import Final

import pytest
from playwright.sync_api import Browser, Playwright, sync_playwright

from tests.console.browser import ARGUMENTS, CHROMIUM, HELD_UP, Visitor
from tests.support.console_process import Console, SignedIn
from tests.support.fixtures import client_fixture, console_fixture, gateway_fixture, patient, session_fixture
from tests.support.gateway_process import Gateway

TRIES: Final = 3


@pytest.fixture(scope="package")
def playwright() -> Iterator[Playwright]:
    with sync_playwright() as running:
        yield running


@pytest.fixture(scope="package")
def browser(playwright: Playwright) -> Iterator[Browser]:
    """Yield Debian's Chromium, which draws WebGL on the processor."""
    running = playwright.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS)
    yield running
    running.close()


@pytest.hookimpl(tryfirst=True)
def pytest_pyfunc_call(pyfuncitem: pytest.Function) -> bool:
    """Run a test. Run it again if a page states that the machine delayed it: then the page releases the robot."""
    given = {name: pyfuncitem.funcargs[name] for name in inspect.signature(pyfuncitem.obj).parameters}
    for left in reversed(range(TRIES)):
        Visitor.lines.clear()
        Visitor.faults.clear()
        try:
            pyfuncitem.obj(**given)
        except Exception:
            held_up = [line for line in Visitor.lines if HELD_UP.search(line)]
            if not (held_up and left):
                raise
            pyfuncitem.user_properties.append(("begun anew, since a page said", held_up[0]))
            for each in given.values():
                if isinstance(each, Visitor):
                    each.close()
        else:
            break
    return True


gateway = gateway_fixture(patient(lease={"ttl_ms": 3000}), scope="package")
console = console_fixture("package")
session = session_fixture("package")
watcher = client_fixture("watcher")


@pytest.fixture
def visitor(browser: Browser, gateway: Gateway, console: Console, session: SignedIn) -> Iterator[Visitor]:
    """Open pages on a robot that is at rest, and end what they left behind."""
    with Visitor(browser, console.url, session, gateway) as pages:
        yield pages
