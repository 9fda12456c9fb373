"""The page shows and does what it says, tells the true cause in its viewer's words, and names who drives."""

import re
from pathlib import Path
from typing import Any, Final

import pytest
from playwright.sync_api import Browser, expect

from gateway.client import Client
from schemas.robot import LEGS
from tests.console.browser import PHONE, Opened, Visitor, behind
from tests.support.console_process import Console
from tests.support.cut_link import CutLink
from tests.support.fixtures import patient
from tests.support.gateway_process import Gateway, free_port
from tests.support.heard import servos_on

pytestmark = pytest.mark.browser

WITHOUT_GATEWAY_MS: Final = 4000
"""So long "You drive" once stood without a gateway."""
TYPED: Final = re.compile("systemctl|journalctl|hexapod-gateway")
CAUSES: Final = (
    "connecting", "offline", "lost", "deaf", "closed", "rejected", "signed_out", "full", "gone", "silent", "old",
    "page_silent", "taken", "gateway", "restarted",
)  # fmt: skip


def test_stop_all_stops_and_says_what_is_known_and_who_else_stopped(visitor: Visitor, gateway: Gateway) -> None:
    page = visitor.open()

    def tap() -> None:
        page["stop-all"].click()

    def escape() -> None:
        page.show_joints()
        page["joint-1"].focus()
        page.page.keyboard.press("Escape")

    def space_with_option() -> None:
        pressed = {"type": "keyDown", "code": "Space", "key": "\u00a0"}
        page.devtools().send("Input.dispatchKeyEvent", pressed)

    with gateway.client(source="bert") as robot:
        for press in (tap, escape, space_with_option):
            before = robot.state().estop
            press()
            expect(page["stop-known"]).to_contain_text("6 Stops written within")
            expect(page["mode"]).to_have_text("stopped, latched")
            assert robot.state().mode == "estopped"
            assert robot.state().estop > before
            assert robot.reset().accepted
            expect(page["stop-line"]).to_have_text("Escape or space, at any time")
        robot.estop()
        expect(page["stop-line"]).to_have_text(re.compile(r"STOPPED by bert, \d\d:\d\d"))


def test_a_reset_asks_first_and_stop_all_answers_no(visitor: Visitor, watcher: Client) -> None:
    page = visitor.open()
    page["stop-all"].click()
    page["reset"].click()
    expect(page["question-no"]).to_be_focused()
    page["stop-all"].click()  # within reach beside the question
    expect(page["question"]).not_to_be_visible()
    expect(page["stop-known"]).to_contain_text("6 Stops written within")
    page["reset"].click()
    page["question-no"].press("Enter")
    assert watcher.state().mode == "estopped"
    page["reset"].click()
    page["question-yes"].click()
    expect(page.said).to_contain_text("Nothing moves until it is started again")
    assert watcher.state().mode == "idle"


@pytest.mark.nightly
@pytest.mark.parametrize("layout", [{}, PHONE], ids=["wide", "held"])
def test_axe_finds_nothing(visitor: Visitor, layout: dict[str, Any]) -> None:
    page = visitor.open(**layout)
    assert page.violations() == {}
    page.get_lease()
    assert page.violations() == {}
    page.show_rest()
    assert page.violations() == {}
    page["stop-all"].click()
    expect(page["stop-known"]).to_contain_text("6 Stops written within")
    assert page.violations() == {}
    page["reset"].click()
    expect(page["question"]).to_be_visible()
    assert page.violations() == {}


def test_an_observer_is_sent_to_the_switch_and_whose_session_was_ended_is_told_how_to_go_on(
    browser: Browser, gateway: Gateway, watcher: Client, tmp_path: Path
) -> None:
    with (
        Console(tmp_path, "--connect", gateway.endpoint, "--role", "observer") as console,
        Visitor(browser, console.url, console.sign_in()) as visitor,
    ):
        page = visitor.open()
        expect(page["stop-line"]).to_have_text("View only: use the power switch")
        expect(page["stop-all"]).to_be_disabled()
        expect(page["controls"]).not_to_be_visible()
        expect(page["walk-controls"]).not_to_be_visible()
        page.page.keyboard.press("Escape")
        page.page.keyboard.press("h")
        page.expect_live()
        assert watcher.state().mode == "idle"
        other = visitor.open()
        other.go_to_button()
        expect(other["word"]).to_have_text("NO BUTTON")
        other["button"].click()
        expect(other["word"]).to_have_text("NO BUTTON")
        assert console.run("--sign-out").returncode == 0
        expect(page["stop-known"]).to_contain_text("NOT CONNECTED: use the switch")
        expect(page["stop-known"]).to_contain_text("You are not signed in")


# ---- causes


def expect_grey(page: Opened, *, grey: bool) -> None:
    """Check whether what moves the robot looks disabled."""
    for name in ("stand", "sit", "lower", "higher", "speed-slow", "speed-fast", "gait-tripod"):
        expect(page[name]).to_be_disabled() if grey else expect(page[name]).to_be_enabled()
    for name in ("pad", "turn", "hold"):
        expect(page[name]).to_have_attribute("aria-disabled", "true" if grey else "false")


def test_a_restarted_gateway_is_the_cause_and_a_phone_is_sent_to_a_person_and_not_to_a_terminal(
    tmp_path: Path, browser: Browser
) -> None:
    settings = patient(lease={"ttl_ms": 1500}, zenoh={"listen": [f"tcp/127.0.0.1:{free_port()}"]})
    with (
        Gateway(tmp_path, settings) as gateway,
        Console(tmp_path, "--connect", gateway.endpoint) as console,
        Visitor(browser, console.url, console.sign_in()) as visitor,
    ):
        phone, desk = visitor.open(**PHONE), visitor.open()
        phone.get_lease()
        expect_grey(phone, grey=False)
        phone["stand"].click()
        expect(phone["walk-known"]).to_contain_text("It stands")
        gateway.close()
        expect(phone["driver"]).to_have_text("unknown", timeout=WITHOUT_GATEWAY_MS)
        for told in (phone["driver"], phone.said):
            expect(told).not_to_have_text(re.compile("^[Yy]ou( drive.*)?$|^It stands"), timeout=WITHOUT_GATEWAY_MS)
        expect_grey(phone, grey=True)
        expect(phone.said).to_contain_text("You do not drive any more: the gateway ", timeout=2 * WITHOUT_GATEWAY_MS)
        for page, next_step, reason in (
            (phone, "Ask the person who runs the robot.", "nothing listens there."),
            (desk, "systemctl status hexapod-gateway", "→ does the gateway run"),
        ):
            expect(page["stop-line"]).to_have_text("NOT CONNECTED: use the switch")
            expect(page["stop-next"]).to_contain_text(next_step)
            expect(page["stop-reason"]).to_contain_text("nothing listens there")
            page["stop-known"].click()
            expect(page.said).to_contain_text(reason)
        assert not TYPED.search(" ".join(phone.page.locator("#stop, #said").all_inner_texts()))
        with Gateway(tmp_path, settings):
            expect(phone.said).to_have_text(
                "You do not drive any more: the gateway was started again. Press Drive to go on."
            )
            expect(phone["driver"]).to_have_text("nobody")


def test_who_moves_the_legs_without_the_lease_is_named(visitor: Visitor, gateway: Gateway) -> None:
    page = visitor.open()
    with gateway.client(source="my tripod") as program:
        for leg in LEGS:
            assert program.start_leg(leg, 90, 90, 90).accepted
        expect(page["driver"]).to_have_text("nobody has the lease; my tripod moves all legs")
        expect(page.said).to_have_text("Nobody has the lease; my tripod moves all legs.")
        expect(page["leg-row-3"].locator(".by")).to_have_text("my tripod")
        for leg in LEGS[2:]:
            program.stop(leg)
        expect(page["driver"]).to_have_text("nobody has the lease; my tripod moves legs 1 and 2")
        program.stop()
    expect(page["driver"]).to_have_text("nobody")


def test_each_cause_has_words_and_none_sends_a_phone_to_a_terminal(
    browser: Browser, console: Console, gateway: Gateway
) -> None:
    with CutLink(f"tcp/127.0.0.1:{console.port}") as tunnel, behind(tunnel, browser, console, gateway) as visitor:
        page = visitor.open()
        worded = page.module(
            "words",
            "(m, causes) => causes.map((cause) => "
            " m.ended({ cause, by: 'bert', forMs: 7000, detail: 'a: b → systemctl' }, false))",
            CAUSES,
        )
        typed = page.module("words", "(m) => ['lost', 'signed_out'].map((cause) => m.ended({ cause }, true).next)")
    for cause, each in zip(CAUSES, worded, strict=True):
        assert each["line"], cause
        assert not TYPED.search(f"{each}"), cause
    assert "bert" in worded[CAUSES.index("taken")]["line"]
    listens = f"--listen {console.url.removeprefix('http://')}"
    assert [each.partition(": ")[2] for each in typed] == [
        f"hexapod-gateway console {listens}",
        f"hexapod-gateway console --link {listens}",
    ], "of the console, also behind a tunnel"


def test_a_driver_who_loads_the_page_anew_still_is_you_and_another_page_is_not(visitor: Visitor) -> None:
    page = visitor.open()
    for drives, stopper in ((False, r"by \S+ \(page \d+\), "), (True, "by you, ")):
        if drives:
            page["reset"].click()
            page["question-yes"].click()
            page.get_lease()
            expect_grey(page, grey=False)
        page["stop-all"].click()
        expect(page["stop-line"]).to_have_text(re.compile("STOPPED by you, "))
        expect(page["stop-next"]).to_have_text("When all are clear, reset.")
        expect_grey(page, grey=True)
        page.page.reload()
        page.expect_live()
        expect(page["stop-line"]).to_have_text(re.compile(f"STOPPED {stopper}"))


# ---- who drives, between two pages and a program


def test_two_pages_ask_hand_over_and_take(visitor: Visitor, watcher: Client) -> None:
    anna, bert = visitor.open(), visitor.open()
    anna.get_lease()
    expect(bert["driver"]).to_contain_text("(page ")
    bert.page.keyboard.press("h")
    expect(bert.said).to_contain_text("this page does not have the lease")

    bert["lease-ask"].click()
    expect(anna.said).to_contain_text("asks for the lease")
    anna["lease-hand-over"].click()
    expect(bert["driver"]).to_have_text("you")
    expect(bert.said).to_have_text("You drive: the lease was handed over to you. Press to move.")
    assert not servos_on(watcher.state())
    expect(anna["driver"]).not_to_have_text("you")

    anna["lease-take"].click()
    anna["question-no"].click()
    expect(bert["driver"]).to_have_text("you")
    bert.show_joints()
    bert["run-all"].click()
    bert.page.keyboard.down("h")
    bert.expect_status(1, "runs")
    anna["lease-ask"].click()
    anna["lease-take"].click()
    anna["question-yes"].click()
    expect(anna["driver"]).to_have_text("you")
    expect(anna.said).to_have_text("You drive: this page has the lease.")  # nobody has handed it over
    expect(anna["events"]).to_contain_text("you have taken the lease from ")
    expect(bert.said).to_contain_text(re.compile(r"\(page \d+\) has taken the lease"))
    bert.expect_status(1, "rests")
    assert watcher.start_leg(1, 90, 90, 90, check=False).reason == "not_holder"
    bert["stop-all"].click()  # the holder of the lease is another
    expect(bert["stop-known"]).to_contain_text("6 Stops written within")
    assert watcher.state().mode == "estopped"


def test_a_page_that_is_hidden_drives_no_more(visitor: Visitor, watcher: Client) -> None:
    page, other = visitor.open(), visitor.open()
    page["lease-acquire"].click()
    expect(other["driver"]).to_contain_text("(page ")
    page.hide()
    expect(other["driver"]).to_have_text("nobody")
    assert watcher.start_leg(1, 90, 90, 90).accepted
    watcher.stop()
    page.show()
    expect(page.said).to_have_text(
        re.compile(
            r"You do not drive any more: this page was hidden, locked or frozen for [\d.]+ s, so its lease ended.*"
        )
    )
