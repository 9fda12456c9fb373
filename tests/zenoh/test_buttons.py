"""Stop buttons on a real gateway: programs that are one, certificates, and a restart."""

from pathlib import Path
from typing import Any

import pytest

from gateway import certs
from gateway.client import Client, RejectedError
from schemas import keys
from schemas.robot import LEGS
from schemas.words import Kind, Mode, Reason
from tests.support.fixtures import client_fixture, gateway_fixture
from tests.support.gateway_process import Gateway, Secured, free_port
from tests.support.heard import events
from tests.support.waiting import meanwhile

TIMEOUT_MS = 2000
POSE = (90, 45, 120)
SETTINGS: dict[str, dict[str, Any]] = {
    "buttons": {"required": 1, "timeout_ms": TIMEOUT_MS},
    "watchdog": {"timeout_ms": 10_000},
}

gateway = gateway_fixture(SETTINGS)

robot = client_fixture("kitchen")


def test_a_program_is_a_button_and_its_silence_stops_all_legs(robot: Client) -> None:
    assert robot.start_leg(3, POSE, check=False).reason == Reason.NO_BUTTON
    heard = events(robot)
    with robot.button("kitchen") as button:
        assert (button.name, button.timeout_ms) == ("kitchen", TIMEOUT_MS)
        assert robot.start_leg(3, POSE, check=False).reason == Reason.NO_BUTTON, "it has not checked in yet"
        assert (button.alive().alive, robot.state().buttons.names) == (1, ("kitchen",))
        with meanwhile(button.alive, TIMEOUT_MS / 1000 / 6):
            assert robot.start_leg(3, POSE).accepted
        silent = heard.wait(lambda event: event.kind == Kind.BUTTON_SILENT)
        assert (silent.source, silent.legs) == ("kitchen", tuple(LEGS))
        assert robot.state().mode == Mode.IDLE
        assert button.alive().alive == 1
        assert heard.wait(lambda event: event.kind == Kind.BUTTON_RETURNED).source == "kitchen"
        assert robot.state().mode == Mode.IDLE, "who is back starts nothing"
    assert heard.wait(lambda event: event.kind == Kind.BUTTON_LEFT).source == "kitchen"


def test_after_a_restart_all_register_anew_and_nothing_moves_before(tmp_path: Path) -> None:
    settings = {**SETTINGS, "zenoh": {"listen": [f"tcp/127.0.0.1:{free_port()}"]}}
    with Gateway(tmp_path, settings) as first, first.client(source="kitchen") as robot:
        button = robot.button("kitchen")
        button.register()
        button.alive()
        first.child.close()
        with Gateway(tmp_path, settings):
            assert robot.wait_ready(20).buttons.alive == 0
            assert robot.start_leg(3, POSE, check=False).reason == Reason.NO_BUTTON
            with pytest.raises(RejectedError, match="unknown_button"):
                button.alive()
            button.register()
            button.alive()
            assert robot.start_leg(3, POSE).accepted
            button.leave()


def test_with_a_ca_the_name_is_proved_and_the_role_button_moves_nothing(tmp_path: Path) -> None:
    with Secured(tmp_path, {"buttons": {"required": 1, "timeout_ms": 5000}}) as secured:
        certs.folder.issue(secured.folder, "kitchen", "button")
        with (
            secured.client("kitchen") as kitchen,
            secured.client("anna") as anna,
            secured.client("otto") as otto,
            kitchen.button("somebody else") as button,
            anna.button() as hers,
        ):
            assert (button.name, hers.name) == ("kitchen", "anna"), "a certificate's person, whatever is asked for"
            assert hers.alive().alive == 1
            assert button.alive().alive == 2
            assert anna.start_leg(3, POSE).accepted
            assert button.press().stop_frames == len(LEGS)
            assert kitchen.state().estop_source == "kitchen"
            assert not list(kitchen.session.get(keys.leg_command(3), payload=b"{}", timeout=1))
            assert not list(otto.session.get(keys.BUTTON, payload=b'{"do":"challenge"}', timeout=1))
