"""From a touch of STOP ALL to the gateway's event, in Chromium as a phone: `python -m tests.benchmarks.touch [COUNT]`.

It includes the browser's driver, the page, the console, Zenoh both ways and the Stops; the processor of the page is
slowed down by 1 and by 6.
"""

import statistics
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Final

from playwright.sync_api import sync_playwright

from schemas.telemetry import Event, Kind
from tests.console.browser import ARGUMENTS, CHROMIUM, Visitor
from tests.support.console_process import Console
from tests.support.gateway_process import Gateway

RATES: Final = (1, 6)
PHONE: Final = "Pixel 7"
PAUSE_S: Final = 0.3


def measure(count: int) -> None:
    """Print a line for each rate."""
    engaged, at_s = threading.Event(), [0.0]

    def received(event: Event) -> None:
        if event.kind == Kind.ESTOP_ENGAGED:
            at_s[0] = time.perf_counter()
            engaged.set()

    with (
        tempfile.TemporaryDirectory() as folder,
        Gateway(Path(folder)) as gateway,
        gateway.client() as robot,
        Console(Path(folder), "--connect", gateway.endpoint) as console,
        sync_playwright() as playwright,
        playwright.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS) as browser,
        Visitor(browser, console.url, console.sign_in()) as visitor,
    ):
        robot.on_event(received)
        page = visitor.open(**playwright.devices[PHONE])
        devtools = page.devtools()
        box = page["stop-all"].bounding_box()
        assert box is not None
        finger = [{"x": box["x"] + box["width"] / 2, "y": box["y"] + box["height"] / 2}]
        for rate in RATES:
            devtools.send("Emulation.setCPUThrottlingRate", {"rate": rate})
            took_ms = []
            for _ in range(count):
                time.sleep(PAUSE_S)
                engaged.clear()
                began_s = time.perf_counter()
                devtools.send("Input.dispatchTouchEvent", {"type": "touchStart", "touchPoints": finger})
                devtools.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})
                assert engaged.wait(10)
                took_ms.append((at_s[0] - began_s) * 1000)
                robot.reset()
            middle, late = statistics.median(took_ms), sorted(took_ms)[int(0.95 * count)]
            print(f"CPU x{rate}: p50 {middle:.1f} ms, p95 {late:.1f} ms, worst {max(took_ms):.1f} ms ({count} touches)")


if __name__ == "__main__":
    measure(int(sys.argv[1]) if sys.argv[1:] else 30)
