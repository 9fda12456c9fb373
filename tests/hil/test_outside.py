"""`stop-servos` beside a running gateway, each a process on the emulated device: what the gateway then says is true."""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from schemas.telemetry import GatewayState, Kind, Mode, Reason
from tests.hil.wire import LATE_S, START_3, STOPS, Replay, Wire, settings_for
from tests.support.child import Child
from tests.support.gateway_process import COMMAND, Gateway, write_settings
from tests.support.heard import events

pytestmark = pytest.mark.hil

NOTICED = "The running gateway counts all servos as stopped"


def begin_to_stop_servos(folder: Path, wire: Wire) -> Child:
    settings = settings_for(wire)
    return wire.bed.spawn([*COMMAND, "stop-servos", "--config", str(write_settings(folder / "stop.toml", settings))])


def stop_servos(folder: Path, wire: Wire) -> Child:
    child = begin_to_stop_servos(folder, wire)
    assert child.wait(LATE_S) == 0, str(child)
    return child


def stop_until_noticed(folder: Path, wire: Wire) -> int:
    """How often it took: a machine that lets the gateway wait for half a second has it be taken for one that hangs."""
    return next(times for times in range(1, 21) if NOTICED in stop_servos(folder, wire).stdout)


def running(state: GatewayState) -> set[int]:
    return {servo.id for leg in state.legs for servo in leg.servos if servo.running}


def test_the_gateway_says_that_its_servos_are_stopped_and_a_start_moves_them_again(
    tmp_path: Path, wire: Wire, gateway: Gateway
) -> None:
    with gateway.client() as client:
        heard = events(client)
        assert client.start_leg(3, 90, 45, 120).accepted
        wire.expect(START_3)
        own = wire.bed.transfers[-1].opening
        times = stop_until_noticed(tmp_path, wire)
        # All of this holds at once when it has ended, not some time later.
        state = client.state()
        assert (state.mode, running(state)) == (Mode.IDLE, set())
        assert "nothing moves until it is started again" in heard.wait(lambda e: e.kind is Kind.STOPPED_OUTSIDE).detail
        assert client.set_leg(3, 91, 45, 120, check=False).reason is Reason.SERVO_STOPPED
        written = wire.skip()
        ours = [each.data.hex() for each in written if each.opening == own and len(each.data) == 14]
        theirs = [each.data.hex() for each in written if each.opening != own and len(each.data) == 14]
        assert sorted(set(ours)) == sorted(STOPS), "the gateway's own Stop for each leg"
        assert theirs == STOPS * 4 * times
        assert client.start_leg(3, 90, 45, 120).accepted
        wire.expect(START_3)
        assert running(client.state()) == {31, 32, 33}
        assert len([event for event in heard.all if event.kind is Kind.STOPPED_OUTSIDE]) in range(1, times + 1)


def test_whoever_starts_legs_meanwhile_the_state_is_what_the_controller_does(
    tmp_path: Path, wire: Wire, gateway: Gateway
) -> None:
    """Legs are started all the time, and once more when the gateway has said that it knows.

    Without Stops of the gateway's own, those would run on that were started after the only Stop from outside; and with
    starts taken as soon as it knows, the next Stops from outside would end them unseen.
    """
    with gateway.client() as client:
        heard = events(client)

        def known(count: int) -> bool:
            return sum(event.kind is Kind.STOPPED_OUTSIDE for event in heard.all) >= count

        def start_legs() -> None:
            for leg in range(1, 7):
                assert client.start_leg(leg, 90, 45, 120, check=False).reason in (None, Reason.SERVO_STOPPED)

        def until_known(count: int) -> None:
            while not known(count):
                start_legs()
            start_legs()

        for count in range(1, 4):
            with ThreadPoolExecutor(1) as pool:
                starter = pool.submit(until_known, count)
                stop_servos(tmp_path, wire)
                starter.result(LATE_S)
            replay = Replay(wire.framing)
            replay.play(wire.bed.transfers)
            assert replay.energised_for_good() == running(client.state())
            assert not replay.controller.corruptions
