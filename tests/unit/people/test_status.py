"""`hexapod-gateway status`: the state in sentences."""

import sys
from collections.abc import Callable, Mapping
from datetime import timedelta

import pytest

from gateway import certs
from gateway.people.commands.status import SILENT_AFTER_NS, Follower, NewsLine, sentences
from gateway.people.watching.dangers import UNCONFIRMED
from schemas.config import CalibrationReport, CertificateReport, WireReport
from schemas.gateway_state import ButtonsReport, ControllerReport, GatewayState, LeaseReport, PowerReport
from schemas.telemetry import Battery
from schemas.words import Mode
from tests.support.published import NS_PER_MS, WALL, rejected, state


@pytest.mark.parametrize("mode", [*Mode, "dancing"])
def test_every_mode_is_a_sentence_also_one_of_a_later_version(mode: str) -> None:
    assert sentences(state().model_copy(update={"mode": mode}))[0].endswith(". Gateway 0.1.0, up 10 s.")


def test_what_runs_who_drives_and_what_watches(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["./hexapod-gateway", "status"])
    changed = {"lease": LeaseReport(holder="anna", held_s=3.0), "buttons": ButtonsReport(alive=1, required=2)}
    found = sentences(state(mode=Mode.ACTIVE, running={3}).model_copy(update={**changed, "incident": "1-crash"}))
    assert "Leg 3 runs at 90°, 90°, 90°." in found
    assert "anna drives." in found
    assert "Stop buttons: 1 alive, 2 required." in found
    assert "Latest incident: 1-crash (./hexapod-gateway incidents show 1-crash)." in found
    assert (
        "Commands accepted: 0, rejected: 0, passed over: 0, lost: 0; legs stopped by the watchdog (250 ms): 0." in found
    )


@pytest.mark.parametrize(
    ("alive", "age_ms", "sentence"),
    [
        (True, 12.0, "The controller (elkapod-2025) is alive."),
        (False, None, "The controller (elkapod-2025) is SILENT."),
        (False, 1234.0, "The controller (elkapod-2025) is SILENT, its last answer 1.2 s ago."),
    ],
)
def test_a_controller_that_answers_and_its_battery(alive: bool, age_ms: float | None, sentence: str) -> None:
    controller = ControllerReport(alive=alive, age_ms=age_ms)
    battery = Battery(voltage_v=7.4, percent=80)
    changed = {"controller": controller, "battery": battery, "wire": WireReport(name="elkapod-2025")}
    found = sentences(state().model_copy(update=changed))
    assert sentence in found
    assert "Battery: 7.40 V, 80 %." in found
    assert not [line for line in sentences(state()) if line.startswith(("The controller", "Battery"))]


# ---- --follow: which lines come of states, events and silence


class Followed:
    """What is shown, 100 ms after each other."""

    def __init__(self) -> None:
        self.lines: list[NewsLine] = []
        self.follower = Follower(self.lines.append, lambda: self.now_ns)
        self.now_ns = 0

    def after(self, act: Callable[[], None]) -> list[str]:
        count = len(self.lines)
        act()
        return [line.text for line in self.lines[count:]]

    def state(self, published: GatewayState | None = None, changed: Mapping[str, object] | None = None) -> list[str]:
        """Receive a state of a gateway that has been up since the beginning."""
        self.now_ns += 100 * NS_PER_MS
        found = (published or state(self.now_ns / 1e9)).model_copy(update=changed or {})
        return self.after(lambda: self.follower.received_state(found, self.now_ns))

    def token(self, alive: bool) -> list[str]:
        return self.after(lambda: self.follower.received_token(alive))

    def look(self, after_ns: int) -> list[str]:
        self.now_ns += after_ns
        return self.after(self.follower.poll)

    def diagnosed(self, text: str) -> list[str]:
        return self.after(lambda: self.follower.diagnosed([text]))


@pytest.fixture
def followed() -> Followed:
    return Followed()


X = WireReport(name="x")


@pytest.mark.parametrize(
    ("changed", "lines"),
    [
        ({"lease": LeaseReport(holder="anna", held_s=1.0)}, ["anna drives."]),
        ({"lease": LeaseReport(holder="bert")}, ["bert is handed the lease."]),
        ({"buttons": ButtonsReport(alive=1, required=2)}, ["Stop buttons: 1 alive, 2 required."]),
        ({"calibration": CalibrationReport(fault="it is torn")}, ["Nothing can be started: it is torn"]),
        ({"mode": Mode.ESTOPPED, "estop_source": "bert"}, ["Emergency stop by bert: nothing runs until a reset."]),
        ({"controller": ControllerReport(alive=True, age_ms=3.0), "wire": X}, ["The controller (x) is alive."]),
        ({"controller": ControllerReport(alive=False, age_ms=9.0), "wire": X}, ["The controller (x) is SILENT."]),
        (
            {"power": PowerReport(interface="can0", alive=False, age_ms=3000.0)},
            ["Power (can0): does not answer.", UNCONFIRMED],
        ),
        (
            {"certificate": CertificateReport(file="gateway.pem", expires=WALL + timedelta(days=3))},
            [f"The robot's gateway.pem expires on 2026-01-05, in 2 days; {certs.renewal('gateway')}"],
        ),
    ],
)
def test_each_change_is_a_line_once(followed: Followed, changed: dict[str, object], lines: list[str]) -> None:
    followed.state()
    assert followed.state(changed=changed) == lines
    assert followed.state(changed=changed) == []


def test_no_source_controls_the_terminal(followed: Followed) -> None:
    followed.follower.received_event(rejected("\x1b[2Janna", "a\nb"))
    assert followed.lines[0].plain.endswith(r"command_rejected   \x1b[2Janna: invalid: a\nb")


@pytest.mark.parametrize("how", ["its token goes", "nothing comes"])
def test_a_gateway_that_falls_silent_and_comes_back(followed: Followed, how: str) -> None:
    assert followed.look(SILENT_AFTER_NS) == [], "none was there yet"
    followed.state()
    assert followed.look(SILENT_AFTER_NS) == []
    silent = ["The gateway is SILENT: what the robot does is not known."]
    assert (followed.token(alive=False) if how == "its token goes" else followed.look(1)) == silent
    assert followed.look(SILENT_AFTER_NS) == [], "once"
    assert followed.token(alive=True)[0].startswith("The gateway publishes again, after ")
    assert followed.state() == []


def test_a_gateway_that_was_started_again_is_a_line_and_an_answer_that_was_overtaken_is_none(
    followed: Followed,
) -> None:
    followed.state(state(100.0))
    assert followed.state(state(99.9, Mode.ACTIVE, running={3})) == []
    assert followed.state(state(0.1, started_s=100.0)) == ["The gateway was started again."]


def test_why_nothing_comes_is_said_once_until_something_does(followed: Followed) -> None:
    assert followed.diagnosed("nobody listens there") == ["nobody listens there"]
    assert followed.diagnosed("nobody listens there") == []
    followed.state()
    assert followed.diagnosed("nobody listens there") == [], "it publishes"
    followed.token(alive=False)
    assert followed.diagnosed("nobody listens there") == ["nobody listens there"]
