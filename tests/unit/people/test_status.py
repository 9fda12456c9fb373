"""`hexapod-gateway status`: the state in sentences."""

import pytest

from gateway.people.commands.status import sentences
from schemas.telemetry import Battery, ButtonsReport, ControllerReport, LeaseReport, Mode, WireReport
from tests.support.published import state


@pytest.mark.parametrize("mode", [*Mode, "dancing"])
def test_every_mode_is_a_sentence_also_one_of_a_later_version(mode: str) -> None:
    assert sentences(state().model_copy(update={"mode": mode}))[0].endswith(". Gateway 0.1.0, up 10 s.")


def test_what_runs_who_drives_and_what_watches() -> None:
    changed = {"lease": LeaseReport(holder="anna", held_s=3.0), "buttons": ButtonsReport(alive=1, required=2)}
    found = sentences(state(mode=Mode.ACTIVE, running=True).model_copy(update=changed))
    assert "Leg 3 runs at 90°, 90°, 90°." in found
    assert "anna drives." in found
    assert "Stop buttons: 1 alive, 2 required." in found


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
