"""A picture to drive by: the page shows it with its age; one that stands still moves nothing."""

import re
from collections.abc import Iterator
from typing import Final

import pytest
from playwright.sync_api import expect

from tests.console.browser import LET_GO, Visitor, again, push, walks
from tests.console.test_still_page import SIZES, overlap_nowhere
from tests.support.camera_server import CameraServer
from tests.support.console_process import Console
from tests.support.fixtures import camera_fixture, gateway_fixture, patient, session_fixture
from tests.support.gateway_process import Gateway

pytestmark = pytest.mark.browser

gateway = gateway_fixture(patient())
session = session_fixture()
camera = camera_fixture()


@pytest.fixture(scope="module")
def console(gateway: Gateway, camera: CameraServer, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Console]:
    """Start a console. Pictures count for four times as long: a busy machine delays them, too."""
    arguments = ("--connect", gateway.endpoint, "--camera", f"front={camera.url}", "--camera-stale-ms", "2000")
    with Console(tmp_path_factory.mktemp("console"), *arguments) as running:
        yield running


OLD: Final = "document.getElementById('said').textContent.includes('The picture was ')"


def test_the_page_shows_a_picture_with_its_age_and_one_that_stands_still_moves_nothing(
    visitor: Visitor, camera: CameraServer
) -> None:
    page = visitor.open()
    expect(page["camera-age"]).to_have_text(re.compile(r"\d\.\d\d s"))
    assert page["camera"].evaluate("(each) => [each.width, each.height]") == [32, 24]
    page.get_lease()
    walks(page, push)
    camera.frozen.set()
    try:
        again(page, lambda: push(page), OLD, LET_GO)
        expect(page["walk-known"]).to_contain_text("It stands")
        expect(page["camera-age"]).to_have_text(re.compile(r"The picture is \d+\.\d s old|has sent no picture for 5 s"))
        expect(page["pad"]).to_have_attribute("aria-disabled", "true")
        expect(page["sit"]).to_be_enabled()
        page.page.mouse.up()
        page["camera-next"].click()
        expect(page["picture"]).to_have_attribute("data-alone", "yes")
        page["camera-next"].click()
        expect(page["camera"]).to_be_hidden()
        walks(page, push)
    finally:
        camera.frozen.clear()
    page.page.mouse.up()
    page["sit"].click()
    expect(page.said).to_have_text("It sits, and its servos are stopped.")


@pytest.mark.nightly
@SIZES
def test_with_a_camera_no_control_is_over_another_or_cut(size: tuple[int, int], visitor: Visitor) -> None:
    overlap_nowhere(size, visitor, ("no", "yes"))
