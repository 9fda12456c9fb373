"""Somebody with a button's certificate, against the other buttons: their places, their number, and their time.

The last of them needs no certificate, only a place on the way: it holds each check-in back a little longer than the
one before.
"""

from collections.abc import Iterator
from pathlib import Path

import pytest

from gateway import certs
from gateway.allowance import NS_PER_MS
from gateway.client import Client, RejectedError
from gateway.people.client.button import Button
from gateway.robot.core.buttons import Buttons
from gateway.robot.core.events import ButtonDo, ButtonRequest
from gateway.robot.core.leg import Rules
from schemas.telemetry import Kind, Reason
from tests.support.heard import events
from tests.support.secured import Secured

TIMEOUT_MS = 1000
POSE = (90, 45, 120)
HOUR_S = 3600


@pytest.fixture
def secured(tmp_path: Path) -> Iterator[Secured]:
    with Secured(tmp_path, {"buttons": {"required": 1, "timeout_ms": TIMEOUT_MS}}) as gateway:
        for name in ("kitchen", "rogue"):
            certs.folder.issue(gateway.folder, name, "button")
        yield gateway


def registered(client: Client, name: str) -> Button | None:
    """A button by that name, or None where the gateway denies it."""
    button = client.button(name)
    try:
        button.register()
    except RejectedError:
        return None
    return button


def test_names_of_one_certificate_take_no_place_of_another(secured: Secured) -> None:
    """Whoever was silent for a moment used to lose its place to the seventeenth name."""
    with secured.client("kitchen") as kitchen, secured.client("rogue") as rogue, secured.client("otto") as otto:
        heard = events(otto)
        button = kitchen.button()
        button.register()
        button.alive()
        heard.wait(lambda event: event.kind == Kind.BUTTON_SILENT)
        for number in range(16):
            registered(rogue, f"rogue/{number}")
        button.alive()
        assert "kitchen" in kitchen.state().buttons.names


def test_names_of_one_certificate_keep_nobody_out(secured: Secured) -> None:
    with secured.client("kitchen") as kitchen, secured.client("rogue") as rogue:
        for number in range(16):
            each = registered(rogue, f"rogue/{number}")
            if each is not None:
                each.alive()
        assert registered(kitchen, "kitchen") is not None


def test_two_names_of_one_certificate_are_not_the_two_that_are_required(tmp_path: Path) -> None:
    with Secured(tmp_path, {"buttons": {"required": 2, "timeout_ms": 5000}}) as secured:
        certs.folder.issue(secured.folder, "rogue", "button")
        with secured.client("rogue") as rogue, secured.client("anna") as anna:
            for number in range(2):
                button = registered(rogue, f"rogue/{number}")
                assert button is not None
                button.alive()
            assert anna.start_leg(3, POSE, check=False).reason == Reason.NO_BUTTON
            hers = anna.button()
            hers.register()
            assert hers.alive().alive == 2
            assert anna.start_leg(3, POSE).accepted


@pytest.mark.parametrize("hours", [1, 10])
def test_check_ins_that_are_held_back_ever_longer_are_old(hours: int) -> None:
    """0.19 ms more each second is less than a slow clock may lose, and was 6.8 s after ten hours."""
    buttons = Buttons(Rules(buttons_required=1, buttons_timeout_ns=TIMEOUT_MS * NS_PER_MS))
    token = "0" * 32
    buttons.grant(ButtonRequest(ButtonDo.REGISTER, 0, "kitchen", sent_ms=0, fresh_token=token), 0)
    counts_ms = 0.0
    for second in range(1, hours * HOUR_S):
        sent_ms, held_back_ms = second * 1000, 0.19 * second
        came_ns = round((sent_ms + held_back_ms) * NS_PER_MS)
        buttons.expire(came_ns)
        check_in = ButtonRequest(ButtonDo.ALIVE, came_ns, token=token, count=second, sent_ms=sent_ms)
        buttons.grant(check_in, came_ns)
        if buttons.due_ns is not None:
            counts_ms = max(counts_ms, buttons.due_ns / NS_PER_MS - sent_ms)
    assert counts_ms <= 1.25 * TIMEOUT_MS + 1
