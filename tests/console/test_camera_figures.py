"""How old a picture is, and what an old one does: ffmpeg's MJPEG server, whose picture has a clock. Prints tables.

The clock is sixteen bars at the picture's top edge: the wall's milliseconds in binary.
"""

import os
import shlex
import signal
import statistics
import subprocess
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Final

import pytest
from playwright.sync_api import Browser, expect

from gateway.model.frames import decode
from schemas.event import FrameRecord
from tests.console.browser import CHANGES, LET_GO, Visitor, behind, push, walks
from tests.support import camera_server
from tests.support.camera_server import CameraServer
from tests.support.console_process import Console
from tests.support.cut_link import CutLink
from tests.support.fixtures import gateway_fixture, patient
from tests.support.gateway_process import Gateway, free_port
from tests.support.heard import frames
from tests.support.waiting import Closing

pytestmark = [pytest.mark.browser, pytest.mark.nightly, pytest.mark.alone]

gateway = gateway_fixture(patient(telemetry={"frames": True}))
BARS: Final = 16
SOURCE: Final = "testsrc2=size=640x480:rate=25,noise=alls=12:allf=t,realtime,settb=1/1000,setpts=RTCTIME/1000"
"""8 Mbit/s."""
FREEZES: Final = 20
STANDS_WITHIN_MS: Final = 700
FRESH: Final = '() => / s( old)?$/.test(document.getElementById("camera-age").textContent)'
CLOCK: Final = """
window.seen = [];
addEventListener("DOMContentLoaded", () => new MutationObserver(() => {
  const canvas = document.getElementById("camera");
  const row = canvas.getContext("2d").getImageData(0, 8, 640, 1).data;
  let ms = 0;
  for (let bar = 0; bar < 16; bar += 1) if (row[(bar * 40 + 20) * 4] > 128) ms |= 1 << bar;
  const shown = /([\\d.]+) s/.exec(document.getElementById("camera-age").textContent);
  if (shown && canvas.width === 640) window.seen.push([1000 * shown[1], (Date.now() - ms + 65536 * 1e6) % 65536]);
}).observe(document.getElementById("camera-age"), { childList: true, characterData: true, subtree: true }));
"""
"""Keeps the age that is shown, and that by the clock, whenever the page shows another one."""
HEARS: Final = f"""{CHANGES}
window.change = (message) => {{
  if (message.type === "stop" && message.answered) window.answeredMs ??= performance.now();
}};
"""


class Ffmpeg(Closing):
    """Serves a test picture with a clock at `url`; again after its only client has left."""

    def __init__(self) -> None:
        bars = ["drawbox=w=640:h=16:color=black:t=fill"]
        for bar in range(BARS):
            on = f"mod(trunc(mod(t*1000\\,65536)/{2**bar})\\,2)"
            bars.append(f"drawbox=x={40 * bar}:w=40:h=16:color=white:t=fill:enable='{on}'")
        self.url = f"http://127.0.0.1:{free_port()}/stream"
        kind = "multipart/x-mixed-replace;boundary=ffmpeg"
        command = (
            f'while :; do ffmpeg -v fatal -f lavfi -i "{",".join([SOURCE, *bars])}" -fps_mode passthrough '
            f'-enc_time_base 1/1000 -c:v mjpeg -q:v 5 -f mpjpeg -content_type "{kind}" -listen 1 {self.url}; done'
        )
        self._child = subprocess.Popen(["/bin/sh", "-c", command], start_new_session=True)

    def freeze(self, *, frozen: bool) -> None:
        os.killpg(self._child.pid, signal.SIGSTOP if frozen else signal.SIGCONT)

    def close(self) -> None:
        os.killpg(self._child.pid, signal.SIGKILL)
        self._child.wait()


@pytest.fixture
def camera() -> Iterator[Ffmpeg]:
    with Ffmpeg() as running:
        yield running


@pytest.fixture
def console(gateway: Gateway, camera: Ffmpeg, tmp_path: Path) -> Iterator[Console]:
    with Console(tmp_path, "--connect", gateway.endpoint, "--camera", camera.url) as running:
        yield running


def worst(values: Sequence[float]) -> str:
    return f"p50 {statistics.median(values):.0f}, worst {max(values):.0f} ms"


LINKS: Final[dict[str, dict[str, float]]] = {
    "unlimited": {},
    "1 Mbit/s": {"bits_a_second": 1e6},
    "200 ms there and back": {"delay_s": 0.1},
}


def test_the_age_that_is_shown_is_that_of_the_clock_in_the_picture(browser: Browser, console: Console) -> None:
    for name, link in LINKS.items():
        with ExitStack() as stack:
            slow = stack.enter_context(CutLink(f"tcp/127.0.0.1:{console.port}", **link))
            page = stack.enter_context(behind(slow, browser, console)).open(script=CLOCK)
            page.page.wait_for_function(FRESH)
            page.page.wait_for_function("() => window.seen.length >= 150")
            seen: list[list[float]] = page.page.evaluate("window.seen")[50:]
        ages, apart = [true for _, true in seen], [shown - true for shown, true in seen]
        print(f"\n{name}: age {worst(ages)}; shown minus true: {min(apart):.0f} to {max(apart):.0f} ms", end="")
        assert len(ages) >= 100, "after the server has begun"


def test_a_robot_stands_when_the_picture_is_frozen(
    browser: Browser, gateway: Gateway, console: Console, camera: Ffmpeg
) -> None:
    """By the frames on SPI: how long after the camera's server was stopped the last servo was sent elsewhere."""
    with gateway.client() as watcher, Visitor(browser, console.url, console.sign_in()) as visitor:
        page = visitor.open()
        page.page.wait_for_function(FRESH)
        page.get_lease()
        written, stood_ms = frames(watcher), list[float]()
        for _ in range(FREEZES):
            walks(page, push)
            camera.freeze(frozen=True)
            frozen_ns = time.monotonic_ns()
            try:
                expect(page["walk-known"]).to_contain_text("It stands")
            finally:
                camera.freeze(frozen=False)
            stood_ms.append((last_moved_ns(written.all) - frozen_ns) / 1e6)
            page.page.wait_for_function(f"() => {LET_GO}")
            page.page.wait_for_function(FRESH)
        within = sum(each < STANDS_WITHIN_MS for each in stood_ms)
        print(f"\nafter the picture froze, the robot stood: {worst(stood_ms)}; {within} of {FREEZES} in time", end="")
        assert within == FREEZES


def last_moved_ns(records: Sequence[FrameRecord]) -> int:
    """Return when a servo was last sent to another angle than before."""
    found: dict[int, int] = {}
    moved_ns = 0
    for record in records:
        for servo_id, op in decode(bytes.fromhex(record.bytes)).servos:
            moved_ns = moved_ns if found.get(servo_id) == op.angle_cdeg else record.monotonic_ns
            found[servo_id] = op.angle_cdeg
    return moved_ns


PRESSES: Final = 40
FRAME_MS: Final = 17
"""One of the screen. The page draws pictures between its messages, so it may be later by as much."""
PRESS: Final = """async () => {
  window.answeredMs = undefined;
  const at = performance.now();
  document.getElementById("stop-all").dispatchEvent(new PointerEvent("pointerdown", { button: 0 }));
  while (window.answeredMs === undefined) await new Promise((resolve) => setTimeout(resolve, 1));
  return window.answeredMs - at;
}"""


def test_stop_all_beside_a_picture(
    browser: Browser, gateway: Gateway, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """8 Mbit/s of a picture that exists: ffmpeg would take a processor beside the page, only while a page shows it."""
    command = shlex.split("ffmpeg -v fatal -f lavfi -i testsrc2=size=640x480 -frames:v 1 -f mjpeg -")
    picture = subprocess.run(command, capture_output=True, check=True).stdout
    monkeypatch.setattr(camera_server, "_PLAIN", picture)
    monkeypatch.setattr(camera_server, "PERIOD_S", 1 / 25)
    with ExitStack() as stack:
        camera = stack.enter_context(CameraServer(size=40_000 - len(picture)))
        console = stack.enter_context(Console(tmp_path, "--connect", gateway.endpoint, "--camera", camera.url))
        visitor = stack.enter_context(Visitor(browser, console.url, console.sign_in()))
        page = visitor.open(script=HEARS)
        took: dict[str, list[float]] = {"a picture": [], "none": []}
        for _ in range(PRESSES):
            for beside, times in took.items():
                while page["camera"].is_visible() != (beside == "a picture"):
                    page["camera-next"].click()
                if beside == "a picture":
                    page.page.wait_for_function(FRESH)
                times.append(page.page.evaluate(PRESS))
        for beside, times in took.items():
            print(f"\nSTOP ALL beside {beside}: {worst(times)}", end="")
        slower_ms = statistics.median(took["a picture"]) - statistics.median(took["none"])
        assert slower_ms < FRAME_MS
        page["reset"].click()
        page["question-yes"].click()
        expect(page["reset"]).to_be_hidden()
