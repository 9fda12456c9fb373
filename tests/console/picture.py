"""Makes the page's pictures anew: `python -m tests.console.picture`.

docs/console.png, where the robot walks; docs/console-held.webp, one sheet of five sizes in all states; the app's icons.
"""

import base64
import re
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from playwright.sync_api import Page, ViewportSize, expect, sync_playwright

from tests.console.browser import ARGUMENTS, CHROMIUM, Opened, Visitor
from tests.console.test_still_page import DESK, HEAR, SHOW, situations
from tests.support.console_process import Console
from tests.support.fixtures import patient
from tests.support.gateway_process import Gateway

ROOT: Final = Path(__file__).parents[2]
PICTURE: Final = ROOT / "docs" / "console.png"
SHEET: Final = PICTURE.with_name("console-held.webp")
PAGE: Final = ROOT / "gateway" / "people" / "console" / "page"
ICONS: Final = (192, 512)
ICON: Final = (
    "<style>body{margin:0;background:#eef0f3} svg{position:absolute;inset:14%%;width:72%%;height:72%%}</style>%s"
)
"""The glyph within the circle that a phone may cut out."""
SIZES: Final = ((360, 640), (390, 844), (844, 390), (768, 1024), DESK)
STATES: Final = (
    "free",
    "another's with a long name",
    "mine",
    "asked for by a long name",
    "standing",
    "walking",
    "limited",
    "halted",
    "ended",
    "stopped by somebody",
    "no gateway",
)
"""Of `situations`, in their order."""
HIGH: Final = 340
"""Of one page in the sheet, in pixels."""
STILL: Final = "{ const at = performance.now(); performance.now = () => at; }"
"""So that no state grows old while the page is looked at."""
MORE: Final = "the rest, in the pads' place"
SHEET_QUALITY: Final = 30
CELL: Final = "<img src='data:image/webp;base64,%s' height='%d'>"
STYLE: Final = """<style>
body { display: flex; flex-wrap: wrap; gap: 10px; width: 2020px; margin: 0; padding: 10px; font: 15px sans-serif; }
img { border: 1px solid #888; } h2 { width: 100%; margin: 6px 0 0; font-size: 20px; }
</style>"""
TRIES: Final = 20
"""Drawing without a graphics card may hold the page up for so long that it stands still."""
SIZE: Final[ViewportSize] = {"width": 1240, "height": 800}


@contextmanager
def visiting(endpoint: str, *arguments: str) -> Iterator[Visitor]:
    """Anna, on that gateway. `arguments` are the console's."""
    with tempfile.TemporaryDirectory() as name, sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS)
        with (
            Console(Path(name), "--connect", endpoint, *arguments, env={"LOGNAME": "anna"}) as console,
            Visitor(browser, console.url, console.sign_in()) as visitor,
        ):
            yield visitor
        browser.close()


@contextmanager
def looked_at(endpoint: str, *arguments: str, size: ViewportSize = SIZE) -> Iterator[Opened]:
    """Anna's page on that gateway, in three dimensions."""
    with visiting(endpoint, *arguments) as visitor:
        page = visitor.open(webgl=True, viewport=size, color_scheme="light")
        page.insist_on_three_dimensions()
        yield page


def walking(visitor: Visitor) -> None:
    """Makes docs/console.png."""
    page = visitor.open(webgl=True, viewport=SIZE, color_scheme="light")
    page.insist_on_three_dimensions()
    page.get_lease()
    page["stand"].click()
    expect(page["walk-known"]).to_contain_text("It stands")
    for _ in range(TRIES):
        page.page.keyboard.down("w")
        page.page.keyboard.down("e")
        expect(page["walk-known"]).to_contain_text(re.compile("to the right|It stands"))
        taken = page.page.screenshot()
        page.page.keyboard.up("w")
        page.page.keyboard.up("e")
        if page["said"].text_content() == "It walks." and (page["age"].text_content() or "").endswith("ms old"):
            PICTURE.write_bytes(taken)
            break
    page.close()


def sheet(visitor: Visitor) -> None:
    """Makes docs/console-held.webp."""
    rows: dict[str, list[str]] = {state: [] for state in (*STATES, MORE)}
    for width, height in SIZES:
        held = (width, height) != DESK
        size: ViewportSize = {"width": width, "height": height}
        page = visitor.open(
            webgl=True, script=HEAR, viewport=size, has_touch=held, is_mobile=held, color_scheme="light"
        )
        page.insist_on_three_dimensions()
        expect(page["quality-known"]).to_contain_text("ms")
        page.page.evaluate(STILL)
        told = situations("anna (page 1)")
        for state in STATES:
            page.page.evaluate(SHOW, told[state])
            rows[state].append(webp(page.page))
        if held:
            page["more"].click()
            rows[MORE].append(webp(page.page))
        page.close()
    with visitor.blank() as paper:
        cells = (f"<h2>{state}</h2>" + "".join(CELL % (each, HIGH) for each in row) for state, row in rows.items())
        paper.set_content(STYLE + "".join(cells))
        SHEET.write_bytes(base64.b64decode(webp(paper, SHEET_QUALITY)))


def webp(page: Page, quality: int = 90) -> str:
    """All of it, in base64."""
    size = page.evaluate("({ width: document.body.scrollWidth, height: document.body.scrollHeight })")
    shot = {"format": "webp", "quality": quality, "captureBeyondViewport": True}
    clip = {"x": 0, "y": 0, "scale": 1, **size}
    data: str = page.context.new_cdp_session(page).send("Page.captureScreenshot", {**shot, "clip": clip})["data"]
    return data


def icons(visitor: Visitor) -> None:
    """Makes the app's icons of the page's own."""
    with visitor.blank() as page:
        page.set_content(ICON % (PAGE / "icon.svg").read_text())
        for size in ICONS:
            page.set_viewport_size({"width": size, "height": size})
            page.screenshot(path=PAGE / f"icon-{size}.png")


def main() -> None:
    with (
        tempfile.TemporaryDirectory() as name,
        Gateway(Path(name), patient()) as gateway,
        visiting(gateway.endpoint) as visitor,
    ):
        icons(visitor)
        sheet(visitor)
        walking(visitor)


if __name__ == "__main__":
    main()
