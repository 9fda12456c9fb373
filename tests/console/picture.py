"""Makes docs/console.png anew: `python -m tests.console.picture`. Four legs are held, two rest."""

import tempfile
from pathlib import Path
from typing import Final

from playwright.sync_api import expect, sync_playwright

from tests.console.browser import ARGUMENTS, CHROMIUM, Visitor
from tests.support.console_process import Console
from tests.support.gateway_process import Gateway

PICTURE: Final = Path(__file__).parents[2] / "docs" / "console.png"
SIZE: Final = {"width": 1240, "height": 800}
POSE: Final = {1: (70, 142, 128), 3: (94, 138, 120), 4: (84, 42, 60), 5: (110, 150, 132)}


def main() -> None:
    with tempfile.TemporaryDirectory() as name, sync_playwright() as playwright:
        folder = Path(name)
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS)
        gateway = Gateway(folder, {"watchdog": {"timeout_ms": 1000}})  # drawing without a graphics card takes long
        with (
            gateway,
            Console(folder, "--connect", gateway.endpoint, env={"LOGNAME": "anna"}) as console,
            Visitor(browser, console.url, console.sign_in()) as visitor,
        ):
            page = visitor.open(webgl=True, viewport=SIZE, color_scheme="light")
            page.drive(*POSE)
            for leg, angles in POSE.items():
                page.select(leg)
                for joint, deg in enumerate(angles, 1):
                    page[f"joint-{joint}"].fill(str(deg))
            page.select(1)
            page.page.keyboard.down("h")
            for leg in POSE:
                page.expect_status(leg, "runs")
            expect(page["number-frames"]).not_to_have_text("0.0")
            page.page.screenshot(path=PICTURE)
            page.page.keyboard.up("h")
        browser.close()


if __name__ == "__main__":
    main()
