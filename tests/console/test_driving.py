"""Hold to run: what the page sends becomes frames; whatever ends it stops the legs."""

import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final

import pytest
from playwright.sync_api import Browser, expect

from gateway.client import Client
from gateway.model.frames import OneLeg, Op, ServoOp, decode
from schemas.event import FrameRecord
from tests.console.browser import GAMEPAD, Opened, Visitor, again
from tests.support.console_process import Console
from tests.support.cut_link import CutLink
from tests.support.fixtures import gateway_fixture, patient, session_fixture
from tests.support.gateway_process import Gateway
from tests.support.heard import Heard, frames, is_stop, last_angles

pytestmark = pytest.mark.browser

TIMEOUT_MS: Final = 2000.0
"""Eight times the default: on a busy machine the page itself is silent for longer than that, which ends a hold."""

gateway = gateway_fixture(patient(TIMEOUT_MS, telemetry={"frames": True}))
session = session_fixture()


@pytest.fixture(scope="module")
def link(gateway: Gateway) -> Iterator[CutLink]:
    with CutLink(gateway.endpoint) as running:
        yield running


@pytest.fixture(scope="module")
def console(link: CutLink, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Console]:
    with Console(tmp_path_factory.mktemp("console"), "--connect", link.endpoint) as running:
        yield running


def hold(page: Opened, watcher: Client, *legs: int) -> Heard[FrameRecord]:
    """Drive these legs by holding H, again if a busy machine ends that. Return what is written from then on."""
    page.drive(*legs)
    written: list[Heard[FrameRecord]] = []

    def press() -> None:
        page.page.keyboard.up("h")
        written.append(frames(watcher))
        page.page.keyboard.down("h")

    held = 'document.getElementById("hold").dataset.held'
    run = f'document.querySelectorAll("#run-chooser [data-runs]").length === {len(legs)}'
    again(page, press, f'{held} === "yes" && {run}', f'{held} === "no"')
    return written[-1]


def wait_for(written: Heard[FrameRecord], leg: int, op: Op, *angles: float) -> None:
    """Wait for exactly this frame."""
    one, two, three = (ServoOp(op, round(deg * 100)) for deg in angles)
    wanted = OneLeg(leg, (one, two, three)).data.hex()
    written.wait(lambda record: record.bytes == wanted)


def of_leg(written: Heard[FrameRecord], leg: int) -> list[FrameRecord]:
    """Return the leg's frames from its first setpoint on: a Stop counts once the leg has moved."""
    found = [(decode(bytes.fromhex(record.bytes)), record) for record in written.all]
    of = [record for frame, record in found if isinstance(frame, OneLeg) and frame.leg == leg]
    return of[next((index for index, record in enumerate(of) if not is_stop(record)), len(of)) :]


def expect_stopped(written: Heard[FrameRecord], *legs: int) -> None:
    """Wait for these legs' Stops, with nothing else after the first. tests/hil measures how late they are."""
    written.wait_for_all(lambda _: all(any(map(is_stop, of_leg(written, leg))) for leg in legs))
    for leg in legs:
        found = of_leg(written, leg)
        assert all(map(is_stop, found[[*map(is_stop, found)].index(True) :]))


def test_sliders_and_typed_angles_come_to_the_wire_and_letting_go_stops(visitor: Visitor, watcher: Client) -> None:
    page = visitor.open()
    page.select(3)
    page["joint-1"].fill("45")
    page["joint-3"].fill("45")
    page.page.get_by_label("Joint 2, degrees, typed").fill("77.25")
    page.page.get_by_label("Joint 2, degrees, typed").press("Enter")
    written = hold(page, watcher, 3, 5)
    wait_for(written, 3, Op.START, 45, 77.25, 45)
    wait_for(written, 5, Op.START, 90, 90, 90)
    page["joint-3"].fill("120")
    wait_for(written, 3, Op.SET, 45, 77.25, 120)
    page.expect_status(3, "runs")
    page.page.keyboard.up("h")
    expect_stopped(written, 3, 5)
    expect(page.said).to_have_text("Let go: legs 3 and 5 stopped.")


def test_a_button_that_is_held_runs_its_leg_and_a_stop_ends_it_for_this_hold(visitor: Visitor, watcher: Client) -> None:
    page = visitor.open()
    page.drive(1)
    page.select(4)
    written = frames(watcher)
    page["hold-leg"].hover()
    page.page.mouse.down()
    wait_for(written, 4, Op.SET, 90, 90, 90)
    assert not of_leg(written, 1)
    page["stop-leg"].focus()
    page.page.keyboard.press("Enter")
    expect_stopped(written, 4)
    page.page.mouse.up()


@pytest.mark.parametrize(
    ("lose", "words"),
    [
        (lambda page, _: page.lose_focus(), "lost the focus"),
        (lambda _, watcher: watcher.stop(1), "servo 11 did not run"),
    ],
    ids=["without focus", "stopped by another"],
)
def test_what_is_lost_stops_the_legs_and_the_page_says_why(
    visitor: Visitor, watcher: Client, lose: Callable[[Opened, Client], object], words: str
) -> None:
    page = visitor.open()
    written = hold(page, watcher, 1, 4)
    lose(page, watcher)
    expect_stopped(written, 1, 4)
    expect(page.said).to_contain_text(words)
    expect(page.said).to_contain_text(re.compile("topped.* legs 1 and 4"))
    page.page.keyboard.down("h")  # the same key, still held: it repeats itself
    expect(page["hold"]).to_have_attribute("data-held", "no")


def test_a_gamepad_runs_one_leg_while_its_trigger_is_pulled_and_may_be_disconnected(
    visitor: Visitor, watcher: Client
) -> None:
    """One that is out of reach: test_walk.py."""
    page = visitor.open(script=GAMEPAD)
    page.drive()
    page.select(2)
    expect(page["gamepad"]).to_be_visible()
    written = frames(watcher)
    page.page.evaluate("pad.buttons[7].value = 1; pad.axes[0] = 1")
    written.wait_for_all(lambda records: last_angles(records).get(21, 0) > 95)
    page.page.evaluate("navigator.getGamepads = () => [null]")
    expect_stopped(written, 2)
    expect(page.said).to_contain_text(re.compile("the gamepad (is|was) disconnected"))


def test_a_cut_link_stops_the_legs_and_what_waited_moves_nothing(
    visitor: Visitor, watcher: Client, link: CutLink
) -> None:
    page = visitor.open()
    written = hold(page, watcher, 1, 4)
    link.cut()
    try:
        expect_stopped(written, 1, 4)
        expect(page.said).to_contain_text("the gateway")  # sends nothing; and later: has not confirmed the lease
        expect(page["stop-known"]).to_contain_text("NOT CONNECTED: use the switch")
    finally:
        link.fix()
    page.expect_live()
    expect_stopped(written, 1, 4)
    for number in ("number-lag", "number-latency"):
        expect(page[number]).to_have_text(re.compile(r"^[\d.]+ · [\d.]+ · [\d.]+ ms$"))


def test_a_console_that_is_killed_stops_the_legs_and_the_next_one_has_its_pages(
    browser: Browser, gateway: Gateway, watcher: Client, tmp_path: Path
) -> None:
    with (
        Console(tmp_path, "--connect", gateway.endpoint) as console,
        Visitor(browser, console.url, console.sign_in(), gateway) as visitor,
    ):
        page = visitor.open()
        written = hold(page, watcher, 1, 4)
        console.close()
        expect_stopped(written, 1, 4)
        expect(page.said).to_contain_text("the connection to the console is lost")
        expect(page["quality"]).to_have_attribute("data-bars", "0")
        expect(page["stop-known"]).to_contain_text("NOT CONNECTED: use the switch")
        page.page.keyboard.press("Escape")
        expect(page["stop-known"]).to_contain_text("asked again once connected")
        with Console(tmp_path, "--connect", gateway.endpoint, port=console.port):
            expect(page["stop-known"]).to_contain_text("6 Stops written within")
