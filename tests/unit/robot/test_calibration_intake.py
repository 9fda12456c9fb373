"""What a CalibrationCommand may be, and what is said of one that is none."""

import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.model.calibration import (
    RobotCalibration,
    calibration_of,
    changed,
    report_of,
)
from gateway.robot.core.calibration_intake import read
from gateway.robot.core.rejections import Rejection
from schemas.calibration import CalibrationCommand
from schemas.command import MAX_PAYLOAD_BYTES
from schemas.robot import SERVO_IDS
from schemas.telemetry import Reason
from tests.unit.model.test_calibration import calibrations

TOKEN = "0123456789abcdef" * 2


def read_whole(payload: object) -> CalibrationCommand:
    command = read(json.dumps(payload).encode())
    assert isinstance(command, CalibrationCommand), command
    return command


def test_all_that_it_may_say() -> None:
    servo = {"trim_deg": -90.0, "inverted": False, "min_deg": 12.34, "max_deg": 180.0}
    payload = {
        "servos": {str(servo_id): servo for servo_id in SERVO_IDS},
        "landing": {str(servo_id): 123.45 for servo_id in SERVO_IDS},
        "revision": 2**53,
        "accept_default": True,
        "source": ":" * 64,
        "sent_ms": 2.0**53,
        "lease": TOKEN,
    }
    assert len(json.dumps(payload)) < MAX_PAYLOAD_BYTES
    command = read_whole(payload)
    assert len(command.servos) == len(command.landing) == 18
    assert (command.accept_default, command.revision, command.lease) == (True, 2**53, TOKEN)
    assert TOKEN not in repr(command)


BAD: list[tuple[object, Reason, str]] = [
    (b"", Reason.MALFORMED, "the payload is not JSON"),
    ([], Reason.INVALID, "the payload: Input should be an object"),
    ({"servos": 3}, Reason.INVALID, "servos: Input should be an object"),
    ({"servos": {"99": {}}}, Reason.INVALID, "servos.99: Input should be '11', '12',"),
    (
        {"servos": {"11": {"trim_deg": 400}}},
        Reason.INVALID,
        "servos.11.trim_deg: Input should be less than or equal to 90",
    ),
    ({"servos": {"11": {"trim_deg": float("nan")}}}, Reason.INVALID, "servos.11.trim_deg: Input should be a finite"),
    ({"servos": {"11": {"inverted": "yes"}}}, Reason.INVALID, "servos.11.inverted: Input should be a valid boolean"),
    (
        {"servos": {"11": {"min_deg": -1}}},
        Reason.INVALID,
        "servos.11.min_deg: Input should be greater than or equal to 0",
    ),
    (
        {"servos": {"11": {"max_deg": 181}}},
        Reason.INVALID,
        "servos.11.max_deg: Input should be less than or equal to 180",
    ),
    ({"servos": {"11": {"speed": 1}}}, Reason.INVALID, "servos.11.speed: Extra inputs"),
    ({"landing": {"11": 181}}, Reason.INVALID, "landing.11: Input should be less than or equal to 180"),
    ({"revision": 1.5}, Reason.INVALID, "revision: Input should be a valid integer"),
    ({"accept_default": False}, Reason.INVALID, "accept_default: Input should be True"),
    ({"lease": TOKEN[1:]}, Reason.INVALID, "lease: String should have at least 32"),
    ({TOKEN: 7}, Reason.INVALID, "(hex digits): Extra inputs"),
    (b'{"servos": {"11": {"trim_deg": 1, "trim_deg": 2}}}', Reason.INVALID, "trim_deg is given twice in one object"),
    (b'{"servos": {"11": {}, "11": {}}}', Reason.INVALID, "11 is given twice in one object"),
    (
        {str(number): 0 for number in range(7 + 18 * 6 + 64)},
        Reason.INVALID,
        "0: Extra inputs are not permitted (and 178 more)",
    ),
    ({str(number): 0 for number in range(7 + 18 * 6 + 65)}, Reason.INVALID, "more fields than any command of its key"),
]


@pytest.mark.parametrize(("payload", "reason", "detail"), BAD, ids=lambda value: repr(value)[:60])
def test_what_is_none_is_rejected_with_the_field_and_its_limit(payload: object, reason: Reason, detail: str) -> None:
    rejection = read(payload if isinstance(payload, bytes) else json.dumps(payload).encode())
    assert isinstance(rejection, Rejection)
    assert rejection.reason == reason
    assert detail in rejection.detail
    assert TOKEN not in rejection.detail


@given(
    st.binary(max_size=200)
    | st.recursive(
        st.none() | st.booleans() | st.floats() | st.text(max_size=8) | st.integers(),
        lambda inner: (
            st.lists(inner, max_size=3)
            | st.dictionaries(
                st.sampled_from(["servos", "landing", "11", "63", "trim_deg", "inverted", "revision", "x"]), inner
            )
        ),
        max_leaves=12,
    ).map(lambda made: json.dumps(made).encode())
)
def test_whatever_comes_is_read_or_rejected_and_never_raises(payload: bytes) -> None:
    assert isinstance(read(payload), CalibrationCommand | Rejection)


@given(calibrations)
def test_what_goes_out_can_be_sent_back_and_changes_nothing(calibration: RobotCalibration) -> None:
    out: dict[str, Any] = json.loads(report_of(calibration).model_dump_json())
    command = read_whole(out)
    assert command.revision == calibration.revision
    assert changed(RobotCalibration(), command).servos == calibration.servos
    assert calibration_of(report_of(calibration)) == calibration
