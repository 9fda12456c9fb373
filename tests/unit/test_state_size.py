"""The state is at most 2 048 bytes, and comes back whole."""

import json
from datetime import UTC, datetime

import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.robot import LEGS, SERVO_IDS
from schemas.state import MAX_STATE_BYTES, Payloads, StateReport, joined
from schemas.telemetry import (
    CUT,
    Battery,
    ButtonsReport,
    CertificateReport,
    CommandCounts,
    ConfigReport,
    ControllerReport,
    GatewayState,
    LeaseReport,
    LegReport,
    LimitsReport,
    LoopLag,
    Mode,
    PowerReport,
    RevocationsReport,
    ServoLimitsReport,
    ServoReport,
    SpiReport,
    StopLatency,
    WatchdogReport,
    WatchdogState,
)
from tests.support import published

MANY = 2**53 - 1
LONG_MS = 123_456_789_012.34567
WHEN = datetime(2026, 11, 26, 22, 0, 0, 123456, UTC)


def servo(servo_id: int) -> ServoReport:
    return ServoReport(id=servo_id, running=True, angle_deg=round(170.01 + servo_id / 100, 2), target_deg=179.99)


def fullest(source: str) -> GatewayState:
    """Every field as long as it can be; each leg has another source, which begins with a number."""

    def name(number: int) -> str:
        return f"{number:02}{source}"[:64]

    return GatewayState(
        mode=Mode.BUS_FAULT,
        time=WHEN,
        uptime_s=LONG_MS,
        version="1.1.0.dev123+g1234567",
        protocol="1.0.0",
        simulated=False,
        legs=tuple(
            LegReport(
                leg=leg,
                watchdog=WatchdogState.EXPIRED,
                age_ms=LONG_MS,
                servos=(servo(10 * leg + 1), servo(10 * leg + 2), servo(10 * leg + 3)),
                source=name(leg),
            )
            for leg in LEGS
        ),
        commands=CommandCounts(accepted=MANY, rejected=MANY, coalesced=MANY, overflows=MANY, lost=MANY),
        spi=SpiReport(device="/dev/" + "x" * 200, framing="elkapod", frames=MANY, errors=MANY),
        watchdog=WatchdogReport(
            timeout_ms=250,
            landing_ms=800,
            expirations=MANY,
            stop_latency_us=StopLatency(p50=98765.4321012345, p99=98765.4321012345, max=LONG_MS),
        ),
        estop=MANY,
        estop_source=name(7),
        estop_since=WHEN,
        estop_fault="/var/lib/hexapod-gateway/" + "x" * 400,
        lease=LeaseReport(holder=name(8), verified=True, held_s=LONG_MS, expires_in_ms=LONG_MS, asked_by=name(9)),
        buttons=ButtonsReport(required=16, alive=16, names=tuple(name(number) for number in range(10, 40))),
        loop_lag_us=LoopLag(p50=98765.4321012345, p99=98765.4321012345, max=LONG_MS),
        incident="2026-11-26T22-00-00Z-" + "x" * 60,
        certificate=CertificateReport(file="gateway.pem", expires=WHEN),
        missing_endpoints=("tls/192.168.100.200:7447",) * 64,
        revocations=RevocationsReport(number=MANY, date=WHEN),
        limits=LimitsReport(servos={str(each): ServoLimitsReport(max_speed_deg_s=123.45) for each in SERVO_IDS}),
        controller=ControllerReport(alive=False, age_ms=LONG_MS),
        battery=Battery(voltage_v=7.400000095367432, percent=80.00000190734863),
        power=PowerReport(
            interface="/dev/serial/by-id/" + "x" * 200, alive=True, supplied=SERVO_IDS, confirmed=False, age_ms=LONG_MS
        ),
        physics="f" * 32,
    )


NAMES = ["", "x" * 64, "\N{SPIDER}" * 64, "\0" * 64, '"' * 64]


@pytest.mark.parametrize("source", NAMES, ids=["short", "long", "wide", "control", "quotes"])
def test_the_fullest_state_is_at_most_2048_bytes(source: str) -> None:
    state, config = Payloads().of(fullest(source))
    sent = state.model_dump_json().encode()
    assert len(sent) <= MAX_STATE_BYTES
    assert StateReport.model_validate_json(sent).model_dump_json().encode() == sent
    assert joined(state, config).legs[3].servos == fullest(source).legs[3].servos, "only texts are cut"


@given(st.text(min_size=1, max_size=64), st.text(max_size=400))
def test_no_text_makes_the_state_too_large(source: str, fault: str) -> None:
    state, _ = Payloads().of(fullest(source).model_copy(update={"estop_fault": fault}))
    assert len(state.model_dump_json().encode()) <= MAX_STATE_BYTES


@pytest.mark.parametrize("running", [(3,), ()])
def test_a_state_and_its_configuration_are_what_the_gateway_knows(running: tuple[int, ...]) -> None:
    state = published.state(running=running, age_ms=12.5, counts=(3, 2, 1))
    sent, config = (json.loads(each.model_dump_json()) for each in Payloads().of(state))
    read = joined(StateReport.model_validate(sent), ConfigReport.model_validate(config))
    assert read == state.model_copy(update={"config": config["config"]})
    assert not {"version", "limits", "wire", "calibration", "protocol"} & sent.keys()
    assert "timeout_ms" not in sent["watchdog"]


def test_another_setting_is_a_new_configuration_and_what_changes_all_the_time_is_none() -> None:
    payloads, state = Payloads(), published.state()
    update = {
        "spi": state.spi.model_copy(update={"frames": 9}),
        "watchdog": state.watchdog.model_copy(update={"expirations": 9}),
        "buttons": state.buttons.model_copy(update={"alive": 9}),
    }
    config = payloads.of(state)[1]
    assert payloads.of(state.model_copy(update=update))[1] == config
    assert payloads.of(published.state(99, Mode.ACTIVE, running={3}))[1] == config
    other = state.model_copy(update={"watchdog": state.watchdog.model_copy(update={"timeout_ms": 300.0})})
    assert payloads.of(other)[1].config != config.config


def test_a_cut_name_is_still_its_sources() -> None:
    state, config = Payloads().of(fullest("x" * 64))
    legs = joined(state, config).legs
    assert str(legs[0].source).endswith(CUT)
    assert legs[0].is_of("01" + "x" * 62)
    assert not legs[0].is_of("02" + "x" * 62)
    assert not legs[0].model_copy(update={"source": CUT}).is_of("anna"), "a name of which nothing is left is nobody's"
