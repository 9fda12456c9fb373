"""Hold to run, on the emulated SPI device: what the page sends comes to the wire; whatever ends it stops the legs."""

import re
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Final

import pytest
from playwright.sync_api import Browser, expect

from gateway.model.frames import OneLeg, Op, decode, stop_leg
from tests.console.browser import GAMEPAD, LATE_MS, Opened, Visitor, again
from tests.hil.bed import SpiTestbed, Transfer
from tests.support.console_process import Console
from tests.support.cut_link import CutLink
from tests.support.fixtures import patient
from tests.support.gateway_process import Gateway

pytestmark = [pytest.mark.browser, pytest.mark.hil]

TIMEOUT_MS: Final = 2000.0
"""Eight times the default: on a busy machine the page itself is silent for longer than that, which ends a hold."""
LEEWAY_MS: Final = 2000.0
"""So long this machine may hold the gateway up; how long its watchdog takes is measured on the device alone."""
NS_PER_MS: Final = 1e6


class Robot:
    """A gateway on the emulated device, and a console that reaches it over a link that can be cut."""

    def __init__(self, folder: Path, bed: SpiTestbed, gateway: Gateway, link: CutLink) -> None:
        self._folder = folder
        self.bed = bed
        self.gateway = gateway
        self.link = link
        self.console = self.begin_console()
        self.session = self.console.sign_in()

    def begin_console(self, port: int | None = None) -> Console:
        self.console = Console(self._folder, "--connect", self.link.endpoint, port=port)
        return self.console

    def wait_for(self, leg: int, op: Op, angles: tuple[float, float, float], since: int = 0) -> None:
        """Wait for exactly this frame on the wire."""
        wanted = [(leg * 10 + joint, op, round(deg * 100)) for joint, deg in zip((1, 2, 3), angles, strict=True)]
        self.bed.wait_for(lambda all_: any(_ops(each) == wanted for each in all_[since:]), LATE_MS / 1000)

    def expect_stopped(self, *legs: int, since: int) -> None:
        """Wait for these legs' Stops, and compare when the first of each came with the leg's last setpoint.

        A Stop counts once the leg has moved: those of legs at rest are written again some seconds later.
        """
        transfers = self.bed.wait_for(lambda all_: all(_stopped(all_, leg, since) for leg in legs), LATE_MS / 1000)
        for leg in legs:
            first = _stopped(transfers, leg, since)
            last = max(index for index, each in enumerate(transfers[:first]) if _moves(each, leg))
            silent_ms = (transfers[first].monotonic_ns - transfers[last].monotonic_ns) / NS_PER_MS
            assert silent_ms <= TIMEOUT_MS + LEEWAY_MS
            assert not any(_moves(each, leg) for each in transfers[first:])


def _ops(transfer: Transfer) -> list[tuple[int, Op, int]]:
    return [(servo, op.op, op.angle_cdeg) for servo, op in decode(transfer.data).servos]


def _stopped(transfers: Sequence[Transfer], leg: int, since: int) -> int:
    """Which transfer is the leg's first Stop behind its first setpoint; 0: none is."""
    begun = next((index for index in range(since, len(transfers)) if _moves(transfers[index], leg)), len(transfers))
    stop = stop_leg(leg).to_bytes()
    return next((index for index in range(begun, len(transfers)) if transfers[index].data == stop), 0)


def _moves(transfer: Transfer, leg: int) -> bool:
    frame = decode(transfer.data)
    return isinstance(frame, OneLeg) and frame.leg == leg and not frame.is_stop


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Robot]:
    folder = tmp_path_factory.mktemp("robot")
    with (
        SpiTestbed() as bed,
        Gateway(folder, patient(TIMEOUT_MS), bed=bed) as gateway,
        CutLink(gateway.endpoint) as link,
    ):
        running = Robot(folder, bed, gateway, link)
        yield running
        running.console.close()


@pytest.fixture
def pages(browser: Browser, robot: Robot) -> Iterator[Visitor]:
    """Opens pages on a robot that is at rest."""
    with Visitor(browser, robot.console.url, robot.session, robot.gateway) as visitor:
        yield visitor


def hold(page: Opened, robot: Robot, *legs: int) -> int:
    """Drive these legs by holding H, anew where a busy machine ends that; from which transfer on they run."""
    page.drive(*legs)
    since = 0

    def press() -> None:
        nonlocal since
        page.page.keyboard.up("h")
        since = len(robot.bed.transfers)
        page.page.keyboard.down("h")

    held = 'document.getElementById("hold").dataset.held'
    run = f'document.querySelectorAll("#run-chooser [data-runs]").length === {len(legs)}'
    again(page, press, f'{held} === "yes" && {run}', f'{held} === "no"')
    return since


def test_sliders_and_typed_angles_come_to_the_wire_and_letting_go_stops(pages: Visitor, robot: Robot) -> None:
    page = pages.open()
    page.select(3)
    page["joint-1"].fill("45")
    page["joint-3"].fill("45")
    page.page.get_by_label("Joint 2, degrees, typed").fill("77.25")
    page.page.get_by_label("Joint 2, degrees, typed").press("Enter")
    since = hold(page, robot, 3, 5)
    robot.wait_for(3, Op.START, (45, 77.25, 45), since)
    robot.wait_for(5, Op.START, (90, 90, 90), since)
    page["joint-3"].fill("120")
    robot.wait_for(3, Op.SET, (45, 77.25, 120), since)
    page.expect_status(3, "runs")
    page.page.keyboard.up("h")
    robot.expect_stopped(3, 5, since=since)
    expect(page.said).to_have_text("Let go: legs 3 and 5 stopped.")


@pytest.mark.parametrize(
    "let_go",
    [lambda page: page.let_go_as("˙", "h"), lambda page: page.page.keyboard.press("Meta")],
    ids=["with another letter", "with Command"],
)
def test_the_key_is_let_go_whatever_else_is_pressed(
    pages: Visitor, robot: Robot, let_go: Callable[[Opened], None]
) -> None:
    """See test_walk.py."""
    page = pages.open()
    since = hold(page, robot, 1, 4)
    let_go(page)
    robot.expect_stopped(1, 4, since=since)
    expect(page.said).to_have_text("Let go: legs 1 and 4 stopped.")


def test_a_button_that_is_held_runs_its_leg_and_a_stop_ends_it_for_this_hold(pages: Visitor, robot: Robot) -> None:
    page = pages.open()
    page.drive(1)
    page.select(4)
    since = len(robot.bed.transfers)
    page["hold-leg"].hover()
    page.page.mouse.down()
    robot.wait_for(4, Op.SET, (90, 90, 90), since)
    assert not any(_moves(each, 1) for each in robot.bed.transfers[since:])
    page["stop-leg"].focus()
    page.page.keyboard.press("Enter")
    robot.expect_stopped(4, since=since)
    page.page.mouse.up()


def _somebody_stops(_page: Opened, robot: Robot) -> None:
    with robot.gateway.client() as client:
        client.stop(1)


@pytest.mark.parametrize(
    ("lose", "words"),
    [
        (lambda page, _: page.hide(), "this page is hidden"),
        (lambda page, _: page.lose_focus(), "this window has lost the focus"),
        (_somebody_stops, "servo 11 does not run"),
    ],
    ids=["hidden", "without focus", "stopped by another"],
)
def test_what_is_lost_stops_the_legs_and_the_page_says_why(
    pages: Visitor, robot: Robot, lose: Callable[[Opened, Robot], None], words: str
) -> None:
    page = pages.open()
    since = hold(page, robot, 1, 4)
    lose(page, robot)
    robot.expect_stopped(1, 4, since=since)
    expect(page.said).to_contain_text(words)
    expect(page.said).to_contain_text(re.compile("topped.* legs 1 and 4"))
    page.page.keyboard.down("h")  # the same key, still held: it repeats itself
    expect(page["hold"]).to_have_attribute("data-held", "no")


def test_a_gamepad_runs_one_leg_while_its_trigger_is_pulled_and_may_be_disconnected(
    pages: Visitor, robot: Robot
) -> None:
    """One that is out of reach: test_walk.py."""
    page = pages.open(script=GAMEPAD)
    page.drive()
    page.select(2)
    expect(page["gamepad"]).to_be_visible()
    since = len(robot.bed.transfers)
    page.page.evaluate("pad.buttons[7].value = 1; pad.axes[0] = 1")
    robot.bed.wait_for(
        lambda all_: any(op[0] == 21 and op[2] > 9500 for each in all_[since:] for op in _ops(each)), LATE_MS / 1000
    )
    page.page.evaluate("navigator.getGamepads = () => [null]")
    robot.expect_stopped(2, since=since)
    expect(page.said).to_contain_text("the gamepad is disconnected")


def test_a_cut_link_stops_the_legs_and_what_waited_moves_nothing(pages: Visitor, robot: Robot) -> None:
    page = pages.open()
    since = hold(page, robot, 1, 4)
    robot.link.cut()
    try:
        robot.expect_stopped(1, 4, since=since)
        expect(page.said).to_contain_text("the gateway")  # sends nothing; and later: has not confirmed the lease
        expect(page["stop-known"]).to_contain_text("NOT CONNECTED: use the switch")
    finally:
        robot.link.fix()
    page.expect_live()
    robot.expect_stopped(1, 4, since=since)


def test_a_console_that_is_killed_stops_the_legs_and_the_next_one_has_its_pages(pages: Visitor, robot: Robot) -> None:
    page = pages.open()
    since = hold(page, robot, 1, 4)
    robot.console.close()
    try:
        robot.expect_stopped(1, 4, since=since)
        expect(page.said).to_contain_text("the connection to the console is lost")
        expect(page["stop-known"]).to_contain_text("NOT CONNECTED: use the switch")
        page.page.keyboard.press("Escape")
        expect(page["stop-known"]).to_contain_text("asked again once connected")
    finally:
        robot.begin_console(robot.console.port)
    expect(page["stop-known"]).to_contain_text("6 Stops written within")
