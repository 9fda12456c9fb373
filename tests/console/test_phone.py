"""`console --phone`: from the QR code's address, over the browser's warning, to a page that stops the robot."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Browser, Playwright, expect

from tests.console.browser import put_to_rest
from tests.console.other_browsers import WebKit
from tests.support.console_process import Console
from tests.support.gateway_process import Gateway


@pytest.fixture
def phone_console(gateway: Gateway, tmp_path: Path) -> Iterator[Console]:
    """It has made its certificate for this machine's address."""
    arguments = ("--phone", "--connect", gateway.endpoint)
    with Console(tmp_path, *arguments, address="0.0.0.0", env={"HOME": str(tmp_path)}) as console:  # noqa: S104
        yield console
    put_to_rest(gateway)


@pytest.mark.browser
def test_a_phone_opens_the_console_by_what_the_page_says_to_tap(
    playwright: Playwright, browser: Browser, phone_console: Console
) -> None:
    with browser.new_context(**playwright.devices["Pixel 7"]) as context:
        page = context.new_page()
        link = phone_console.new_link()
        assert link.startswith("http://")
        page.goto(link)
        expect(page.locator("h1")).to_have_text("One tap, and the console opens")
        assert [each["id"] for each in Axe().run(page).response["violations"]] == []
        page.get_by_text("Open the console").tap()
        page.locator("#details-button").tap()  # "Advanced", of Chromium's warning
        page.locator("#proceed-link").tap()
        expect(page.locator("body")).to_have_attribute("data-live", "yes")
        assert page.url == f"{phone_console.url}/"
        page.locator("#stop-all").tap()
        expect(page.locator("#stop-known")).to_contain_text("6 Stops written within")
        page.reload()  # nothing is to be tapped again
        expect(page.locator("body")).to_have_attribute("data-live", "yes")


@pytest.mark.other_browsers
@pytest.mark.nightly
def test_webkit_opens_it_too(phone_console: Console, tmp_path: Path) -> None:
    """Its driver accepts what a person taps: it shows no warning of its own."""
    with WebKit(tmp_path, accepts_any_certificate=True) as page:
        page.go_to(phone_console.new_link())
        page.wait_for_words("One tap, and the console opens")
        page.wait('document.getElementById("open").href.startsWith("https://")')
        page.go_to(page.find('document.getElementById("open").href'))
        page.wait('document.body.dataset.live === "yes"')
        page.click("STOP ALL")
        page.wait_for_words("6 Stops written within")
