"""How a browser gets in, stays in, by a QR code, too, and what a page of somebody else gets of it."""

import http.server
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Browser, Playwright, expect

from tests.console.browser import WITHOUT_WEBGL, Opened, put_to_rest
from tests.console.other_browsers import WebKit
from tests.support.console_process import Console
from tests.support.gateway_process import Gateway


@contextmanager
def signed_in(browser: Browser, console: Console) -> Iterator[Opened]:
    with browser.new_context() as context:
        context.add_init_script(WITHOUT_WEBGL)
        opened = Opened(context, context.new_page())
        opened.page.goto(console.new_link())
        opened.expect_live()
        yield opened


@pytest.mark.browser
def test_a_link_a_reload_and_a_second_tab(browser: Browser, console: Console) -> None:
    with signed_in(browser, console) as first:
        assert first.page.url == f"{console.url}/", "neither the link nor the key stays in the address"
        first.page.reload()
        first.expect_live()
        second = Opened(first.context, first.context.new_page())
        second.page.goto(console.url)
        second.expect_live()


@pytest.mark.browser
def test_whoever_takes_the_port_of_a_console_that_is_gone_gets_no_key(
    browser: Browser, gateway: Gateway, tmp_path: Path
) -> None:
    """Another user of this machine waits for a restart: the page reconnects, sends nothing of worth, and comes back."""
    console = Console(tmp_path, "--connect", gateway.endpoint)
    with signed_in(browser, console) as page:
        key = page.page.evaluate("localStorage.getItem('hexapod-console-key')")
        console.close()
        with listening(console.port) as requests:
            expect(page["stop-known"]).to_contain_text("another program may listen here")
            assert len(requests) > 0
            assert not [each for each in requests if key in each]
            assert not [each for each in requests if "websocket" in each], "nothing is said to who has proved nothing"
        with Console(tmp_path, "--connect", gateway.endpoint, port=console.port):
            page.expect_live()


@contextmanager
def listening(at: int) -> Iterator[list[str]]:
    """Yield another web server at that port, and the requests that it received."""
    requests: list[str] = []

    class Handler(http.server.BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            requests.append(f"{self.path}\n{self.headers}")
            self.send_response(200)
            self.send_header("Content-Type", "text/html")
            self.end_headers()
            self.wfile.write(b"<!doctype html><title>Free kittens</title>")

    with http.server.ThreadingHTTPServer(("127.0.0.1", at), Handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield requests
        server.shutdown()


@pytest.fixture
def phone_console(gateway: Gateway, tmp_path: Path) -> Iterator[Console]:
    """Start a console that has made a certificate for this machine's address."""
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
