"""The page of a robot that is simulated with physics: where its body is, and how somebody sets it upright."""

import re
from pathlib import Path
from typing import Final

import pytest
from playwright.sync_api import Browser, expect

from gateway.client import Client
from tests.console.browser import Visitor
from tests.support.console_process import Console
from tests.support.fixtures import patient
from tests.support.gateway_process import Gateway

pytestmark = [pytest.mark.browser, pytest.mark.nightly]

PATIENT: Final = patient(10_000)
"""A browser that draws on the processor leaves little of it to others."""
STEEP: Final = "--sim=physics --terrain slope:30 --friction 3 --mass-kg 1 --servo-torque-nm 20"


def both_sides(client: Client, legs: tuple[int, ...], second_deg: float, third_deg: float, verb: str) -> None:
    """Do the same to left and right legs, whose servos are mirrored."""
    angles = {leg: (90, second_deg, third_deg) if leg % 2 else (90, 180 - second_deg, 180 - third_deg) for leg in legs}
    assert getattr(client, verb)(angles).accepted


def test_a_fallen_robot_is_set_upright(browser: Browser, tmp_path: Path) -> None:
    """On a slope, against which its height and its leaning count."""
    with (
        Gateway(tmp_path, PATIENT, options=STEEP.split()) as gateway,
        Console(tmp_path, "--connect", gateway.endpoint) as console,
        Visitor(browser, console.url, console.sign_in()) as visitor,
        gateway.client() as client,
    ):
        page = visitor.open(webgl=True)
        for view in ("view-above", "view-solid"):  # who chooses them by hand gets them, however slow they are
            page[view].check(force=True)
        expect(page["sim-known"]).to_have_text(re.compile("^[5-7] cm high, leaning by [01]°"))
        both_sides(client, (1, 2, 3, 4, 5, 6), 150, 110, "start_legs")
        both_sides(client, (1, 2, 3, 4), 0, 20, "set_legs")  # which push it over backwards
        expect(page["sim-known"]).to_have_text(re.compile("on its back"))
        page.page.screenshot(path=tmp_path / "fallen.png")
        assert client.stop().accepted
        page["set-upright"].click()
        expect(page["said"]).to_have_text("It stands on its feet again.")
