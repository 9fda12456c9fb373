"""The page says what it knows: link, gateway, console and page are broken one by one, and its words meet the wire's.

The page is reached through a cut link, as behind Wi-Fi or a tunnel, and notes its own words each 100 ms.
"""

import os
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, Final, NamedTuple

import pytest
from playwright.sync_api import Browser

from gateway.model.frames import OneLeg, decode
from schemas.event import FrameRecord
from tests.console.browser import Opened, Visitor, behind, walks
from tests.support.child import frozen
from tests.support.console_process import Console
from tests.support.cut_link import CutLink
from tests.support.fixtures import patient
from tests.support.gateway_process import Gateway, free_port
from tests.support.heard import frames, is_stop, servos_on, states

pytestmark = pytest.mark.browser

NOTES: Final = """
window.notes = [];
addEventListener("DOMContentLoaded", () => setInterval(() => {
  const of = (id) => document.getElementById(id).textContent;
  const runs = [...document.querySelectorAll(".label")].filter((each) => each.dataset.status === "runs").length;
  const rows = document.querySelectorAll('.status[data-status="runs"]').length;
  window.notes.push({
    at: Date.now(), runs, rows, walk: of("walk-known"), said: of("said"), band: of("stop-line"), driver: of("driver"),
    mode: of("mode"), quality: of("quality-known"), live: document.body.dataset.live,
  });
}, 100));
"""
AFTER_MS: Final = 900
"""A state counts for 500 ms, the page looks each 100 ms, and a busy machine may be late."""
CLAIMS: Final = ("It walks", "It stands", "It moves", "It sits", "It goes on", "You drive")
GONE_MS: Final = 8000
"""A robot whose page is gone sits after 5 s, and is stopped."""


class Broken(NamedTuple):
    """The parts that a test breaks."""

    gateway: Gateway
    console: Console
    to_gateway: CutLink
    to_page: CutLink
    page: Opened
    renderers: set[int]


@contextmanager
def cut(link: CutLink) -> Iterator[None]:
    link.cut()
    try:
        yield
    finally:
        link.fix()


@contextmanager
def killed(console: Console) -> Iterator[None]:
    os.kill(console.child.pid, signal.SIGKILL)
    yield


@contextmanager
def hidden(page: Opened) -> Iterator[None]:
    page.hide()
    yield
    page.show()


BREAKS: Final[dict[str, Callable[[Broken], Any]]] = {
    "the page's link": lambda of: cut(of.to_page),
    "the gateway's link": lambda of: cut(of.to_gateway),
    "the console hangs": lambda of: frozen(of.console.child.pid),
    "the console dies": lambda of: killed(of.console),
    "the gateway hangs": lambda of: frozen(of.gateway.child.pid),
    "the page freezes": lambda of: frozen(*of.renderers),
    "the page is hidden": lambda of: hidden(of.page),
}


def ran(written: Sequence[FrameRecord]) -> list[tuple[float, bool]]:
    """Return when servos began to run, and when all were stopped, by the frames: ms, and whether one runs."""
    legs: dict[int, bool] = {}
    found = [(0.0, False)]
    for record in written:
        frame = decode(bytes.fromhex(record.bytes))
        if isinstance(frame, OneLeg):
            legs[frame.leg] = not is_stop(record)
            if found[-1][1] != any(legs.values()):
                found.append((record.time.timestamp() * 1000, any(legs.values())))
    return found


def truth(spans: list[tuple[float, bool]], at_ms: float) -> set[bool]:
    """Return whether a servo ran at some time, or did not, within what the page may still not know."""
    ends = [*(began for began, _ in spans[1:]), float("inf")]
    return {runs for (began, runs), end in zip(spans, ends, strict=True) if began <= at_ms and end >= at_ms - AFTER_MS}


def false_words(note: dict[str, Any], runs: set[bool], *, reached: bool) -> list[str]:
    """Return what the page says of the robot, and cannot know, or is not so."""
    words = [f"{each}: {note[each]}" for each in ("walk", "said") if note[each].startswith(CLAIMS)]
    words += [f"{note[each]} legs run" for each in ("runs", "rows") if note[each]]
    words += [
        f"{each}: {note[each]}" for each in ("driver", "mode", "quality") if note[each] not in ("unknown", "no link")
    ]
    if not reached:
        return words
    says = {False for each in (note["walk"],) if each.startswith("It sits")} | {
        True for each in ("runs", "rows") if note[each]
    }
    return [f"{word}; but: {runs}" for word in words if says and not says & runs]


def press_w(page: Opened) -> None:
    page.page.keyboard.up("w")
    page.page.keyboard.down("w")


EACH_COMMIT: Final = ("the page's link", "the console hangs", "the gateway hangs")


@pytest.mark.parametrize(
    "what", [each if each in EACH_COMMIT else pytest.param(each, marks=pytest.mark.nightly) for each in BREAKS]
)
def test_what_the_page_says_is_known_and_true(browser: Browser, tmp_path: Path, what: str) -> None:
    settings = patient(
        lease={"ttl_ms": 3000}, telemetry={"frames": True}, zenoh={"listen": [f"tcp/127.0.0.1:{free_port()}"]}
    )
    with ExitStack() as stack:
        gateway = stack.enter_context(Gateway(tmp_path, settings))
        to_gateway = stack.enter_context(CutLink(gateway.endpoint))
        console = stack.enter_context(Console(tmp_path, "--connect", to_gateway.endpoint))
        to_page = stack.enter_context(CutLink(f"tcp/127.0.0.1:{console.port}"))
        dies = what == "the console dies"
        visitor = stack.enter_context(
            Visitor(browser, console.url, console.sign_in()) if dies else behind(to_page, browser, console)
        )
        before = visitor.renderers()
        page = visitor.open(script=NOTES)
        broken = Broken(
            gateway, console, to_gateway, to_page, page, visitor.renderers() - before or visitor.renderers()
        )
        watcher = stack.enter_context(gateway.client())
        written = frames(watcher)
        page.get_lease()
        walks(page, press_w)
        with BREAKS[what](broken):
            began_ms = time.time() * 1000
            if what == "the page freezes":
                states(watcher).wait(lambda state: not servos_on(state))
            else:
                page.page.wait_for_function(f"() => Date.now() > {began_ms + GONE_MS}")
            ended_ms = time.time() * 1000
        if not dies:
            page.expect_live()
        last = page.page.evaluate("window.notes.length")
        page.page.wait_for_function(f"() => window.notes.length > {last + 5}")
        notes = page.page.evaluate("window.notes")
    judge(what, notes, ran(written.all), began_ms, ended_ms)


def judge(
    what: str, notes: list[dict[str, Any]], spans: list[tuple[float, bool]], began_ms: float, ended_ms: float
) -> None:
    """Compare each of the page's words with the wire, and print the table."""
    rows: dict[tuple[str, ...], list[float]] = {}
    faults = []
    for note in notes:
        known_ms = note["at"] - began_ms
        broken = began_ms + AFTER_MS < note["at"] < ended_ms and what != "the page is hidden"
        runs = truth(spans, note["at"])
        found = false_words(note, runs, reached=not broken)
        faults += [f"{known_ms / 1000:.1f} s: {word}" for word in found]
        state = (
            "broken" if broken else "before" if known_ms < 0 else "after" if note["at"] > ended_ms else "just broken"
        )
        key = (
            state,
            note["walk"],
            note["said"],
            note["band"],
            "/".join("runs" if each else "rests" for each in sorted(runs)),
        )
        rows.setdefault(key, []).append(known_ms)
    print(f"\n{what} | from s | walk line | said | band | true")
    for (state, *words), when in rows.items():
        print(f"{state} | {when[0] / 1000:.1f} ({len(when)}) | " + " | ".join(words))
    assert not faults, "\n".join(faults[:20])
    assert any(began_ms + AFTER_MS < note["at"] for note in notes)
