"""Makes docs/console.png anew: `python -m tests.console.picture`. The robot walks."""

import re
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from playwright.sync_api import ViewportSize, expect, sync_playwright

from tests.console.browser import ARGUMENTS, CHROMIUM, Opened, Visitor
from tests.support.console_process import Console
from tests.support.fixtures import patient
from tests.support.gateway_process import Gateway

PICTURE: Final = Path(__file__).parents[2] / "docs" / "console.png"
TRIES: Final = 20
"""Drawing without a graphics card may hold the page up for so long that it stands still."""
SIZE: Final[ViewportSize] = {"width": 1240, "height": 800}


@contextmanager
def looked_at(endpoint: str, *arguments: str, size: ViewportSize = SIZE) -> Iterator[Opened]:
    """Anna's page on that gateway, in three dimensions. `arguments` are the console's."""
    with tempfile.TemporaryDirectory() as name, sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS)
        with (
            Console(Path(name), "--connect", endpoint, *arguments, env={"LOGNAME": "anna"}) as console,
            Visitor(browser, console.url, console.sign_in()) as visitor,
        ):
            page = visitor.open(webgl=True, viewport=size, color_scheme="light")
            page.insist_on_three_dimensions()
            yield page
        browser.close()


def main() -> None:
    with (
        tempfile.TemporaryDirectory() as name,
        Gateway(Path(name), patient()) as gateway,
        looked_at(gateway.endpoint) as page,
    ):
        page.get_lease()
        page["stand"].click()
        expect(page["walk-known"]).to_contain_text("It stands")
        for _ in range(TRIES):
            page.page.keyboard.down("w")
            page.page.keyboard.down("e")
            expect(page["walk-known"]).to_contain_text(re.compile("0.0[1-9] m/s|It stands"))
            taken = page.page.screenshot()
            page.page.keyboard.up("w")
            page.page.keyboard.up("e")
            if page["said"].text_content() == "It walks.":
                PICTURE.write_bytes(taken)
                break


if __name__ == "__main__":
    main()
