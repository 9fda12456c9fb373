"""Who drives, between two pages and a program."""

import re

import pytest
from playwright.sync_api import expect

from tests.console.browser import Visitor
from tests.support.gateway_process import Gateway
from tests.support.heard import servos_on

pytestmark = pytest.mark.browser


def test_two_pages_ask_hand_over_and_take(visitor: Visitor, gateway: Gateway) -> None:
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
    with gateway.client() as robot:
        assert not servos_on(robot.state())
    expect(anna["driver"]).not_to_have_text("you")

    anna["lease-take"].click()
    anna["question-no"].click()
    expect(bert["driver"]).to_have_text("you")
    bert.show_joints()
    bert["run-all"].click()
    bert.page.keyboard.down("h")
    bert.expect_status(1, "runs")
    anna["lease-take"].click()
    anna["question-yes"].click()
    expect(anna["driver"]).to_have_text("you")
    expect(bert.said).to_contain_text(re.compile(r"\(page \d+\) has taken the lease"))
    bert.expect_status(1, "rests")
    with gateway.client(source="a program") as robot:
        assert robot.start_leg(1, 90, 90, 90, check=False).reason == "not_holder"
        bert["stop-all"].click()  # whoever drives
        expect(bert["stop-known"]).to_contain_text("6 Stops written within")
        assert robot.state().mode == "estopped"


def test_a_page_that_is_hidden_drives_no_more(visitor: Visitor, gateway: Gateway) -> None:
    page, other = visitor.open(), visitor.open()
    page["lease-acquire"].click()
    expect(other["driver"]).to_contain_text("(page ")
    page.hide()
    expect(other["driver"]).to_have_text("nobody")
    with gateway.client() as robot:
        assert robot.start_leg(1, 90, 90, 90).accepted
        robot.stop()
    page.show()
    expect(page.said).to_have_text(
        re.compile(
            r"You do not drive any more: this page was hidden, locked or frozen for [\d.]+ s, so its lease ended.*"
        )
    )
