"""How a browser gets in, stays in, and what a page of somebody else's gets of it."""

import http.server
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from playwright.sync_api import Browser, expect

from tests.console.browser import WITHOUT_WEBGL, Opened
from tests.support.console_process import Console
from tests.support.gateway_process import Gateway

pytestmark = pytest.mark.browser


@contextmanager
def signed_in(browser: Browser, console: Console) -> Iterator[Opened]:
    """Yield a page in a browser of its own, which has just opened a link."""
    with browser.new_context() as context:
        context.add_init_script(WITHOUT_WEBGL)
        opened = Opened(context, context.new_page())
        opened.page.goto(console.new_link())
        opened.expect_live()
        yield opened


def test_a_link_a_reload_and_a_second_tab(browser: Browser, console: Console) -> None:
    with signed_in(browser, console) as first:
        assert first.page.url == f"{console.url}/", "neither the link nor the key stays in the address"
        first.page.reload()
        first.expect_live()
        second = Opened(first.context, first.context.new_page())
        second.page.goto(console.url)
        second.expect_live()


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
    """Yield a web server of somebody else's, at that port; the requests that it got."""
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
