"""What a stream makes of a gateway's silence, its end and its watchdog, in virtual time: no thread, no gateway."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from datetime import timedelta
from types import SimpleNamespace
from typing import Any, Self

import pytest

from gateway.errors import DisconnectedError, RejectedError, StoppedError, UnansweredError
from gateway.people.client.pace import SILENCE_S
from gateway.people.client.stream import AGAIN, WHOLE, Stream, happened
from schemas.telemetry import Ack, ControllerReport, Event, GatewayState, Kind, Mode, Reason, WatchdogState
from tests.support.published import WALL, event, state

HZ = 50
PERIOD_S = 1 / HZ
POSE = (90, 45, 120)


class Robot:
    """A client and its gateway. Time passes where the stream sleeps, and where a test says so."""

    name = "anna's laptop"
    carried_lease = None

    def __init__(self) -> None:
        self.now_s = 100.0
        self.connected = True
        self.answers = True
        self.published: list[tuple[float, list[str]]] = []
        self.asked: list[str] = []
        self.questions = 0
        self.running: set[int] = set()
        self.expired: set[int] = set()
        self.changed: dict[str, object] = {}
        """In its state."""
        self._hears_state: Callable[[GatewayState], None] = lambda _: None
        self.publish_event: Callable[[Event], None] = lambda _: None

    # ---- the clock that the stream reads

    def monotonic(self) -> float:
        return self.now_s

    def sleep(self, seconds: float) -> None:
        self.now_s += seconds

    # ---- a client's side of it

    def on_state(self, callback: Callable[[GatewayState], None]) -> Self:
        self._hears_state = callback
        return self

    def on_event(self, callback: Callable[[Event], None]) -> Self:
        self.publish_event = callback
        return self

    def undeclare(self) -> None:
        pass

    def check_open(self) -> None:
        pass

    def publish(self, _key: str, payload: Mapping[str, Any]) -> None:
        self.published.append((self.now_s, list(payload["legs"])))

    def ask(self, _key: str, payload: Mapping[str, Any], *, again: bool = False) -> Ack:
        self.asked.append("stop" if again else "start")
        legs = {int(leg) for leg in payload["legs"]}
        self.running = self.running - legs if again else self.running | legs
        return Ack(accepted=True)

    def state(self, _timeout_s: float = 0.0) -> GatewayState:
        self.questions += 1
        if not self.answers:
            raise UnansweredError("no gateway answered")
        return self.report()

    # ---- the gateway's

    def report(self) -> GatewayState:
        found = state(self.now_s)
        legs = [
            leg.model_copy(
                update={
                    "servos": tuple(
                        each.model_copy(update={"running": leg.leg in self.running}) for each in leg.servos
                    ),
                    "watchdog": WatchdogState.EXPIRED if leg.leg in self.expired else WatchdogState.IDLE,
                    "source": self.name,
                }
            )
            for leg in found.legs
        ]
        return found.model_copy(update={"legs": tuple(legs), **self.changed})

    def publish_state(self) -> None:
        self._hears_state(self.report())


@pytest.fixture
def robot(monkeypatch: pytest.MonkeyPatch) -> Robot:
    found = Robot()
    monkeypatch.setattr("gateway.people.client.stream.time", found)
    return found


@pytest.fixture
def stream(robot: Any) -> Iterator[Stream]:
    """Legs 1 and 2 run, and a state has just been published."""
    with Stream(robot, HZ) as found:
        found.set({1: POSE, 2: POSE})
        robot.publish_state()
        robot.questions = 0
        yield found


def go_on(robot: Robot, stream: Stream, for_s: float, legs: Iterable[int] = (1, 2), *, publishes: bool = True) -> None:
    end_s = robot.now_s + for_s
    for _ in range(round(for_s * HZ) + 1):
        if robot.now_s >= end_s:
            break
        stream.set(dict.fromkeys(legs, POSE))
        if publishes:
            robot.publish_state()


def test_it_sends_what_it_is_given_once_a_tick_and_asks_nothing(robot: Robot, stream: Stream) -> None:
    begun_s = robot.now_s
    go_on(robot, stream, 1.0 - PERIOD_S / 2)
    assert [sent_s - begun_s for sent_s, _ in robot.published] == pytest.approx([tick / HZ for tick in range(1, 51)])
    assert (robot.questions, stream.missed) == (0, 0)


def test_a_gateway_that_publishes_nothing_but_answers_is_asked_twice_a_second(robot: Robot, stream: Stream) -> None:
    go_on(robot, stream, 2.9 * SILENCE_S, publishes=False)
    assert robot.questions == 2
    assert not stream.is_over


def test_a_link_that_is_cut_without_a_word_ends_it_after_half_a_second(robot: Robot, stream: Stream) -> None:
    begun_s, robot.answers = robot.now_s, False
    with pytest.raises(DisconnectedError, match="did not answer"):
        go_on(robot, stream, 60.0, publishes=False)
    assert robot.now_s - begun_s == pytest.approx(SILENCE_S, abs=PERIOD_S)
    sent = len(robot.published)
    robot.answers = True
    with pytest.raises(DisconnectedError):
        stream.set({1: POSE})
    assert len(robot.published) == sent, "it does not go on by itself"


def test_a_link_that_is_known_to_be_lost_ends_it_at_once(robot: Robot, stream: Stream) -> None:
    robot.connected = False
    with pytest.raises(DisconnectedError, match="the link to the gateway was lost"):
        stream.set({1: POSE})
    assert (robot.published, robot.questions) == ([], 0)


def test_a_program_that_stalls_asks_before_it_sends_and_learns_what_the_watchdog_stopped(
    robot: Robot, stream: Stream
) -> None:
    robot.sleep(0.25)
    robot.running, robot.expired = set(), {1, 2}
    for _ in range(2):
        with pytest.raises(StoppedError, match=r"no command in .* ms") as error:
            stream.set({1: POSE, 2: POSE})
        assert error.value.legs == (1, 2)
        assert error.value.__notes__ == [AGAIN]
    assert (robot.published, robot.asked) == ([], ["start"]), "nothing moves that was stopped"
    stream.start_again()
    stream.set({2: POSE})
    assert (robot.asked, robot.running) == (["start", "start"], {2})
    assert stream.missed > 10


def test_the_end_of_a_stream_whose_lease_is_elsewhere_stops_nothing(robot: Any) -> None:
    """Whoever was handed it, or took it, may drive these legs."""
    robot.carried_lease = SimpleNamespace(elsewhere=False, check=lambda: None)
    with Stream(robot, HZ) as stream:
        stream.set({1: POSE})
        robot.carried_lease.elsewhere = True
    assert robot.running == {1}


def test_a_leg_that_is_left_out_is_stopped_and_not_repeated(robot: Robot, stream: Stream) -> None:
    go_on(robot, stream, 0.2, legs=[2])
    robot.running, robot.expired = {2}, {1}
    robot.publish_state()
    with pytest.raises(StoppedError, match="leg 1: no command") as error:
        stream.set({2: POSE})
    assert error.value.legs == (1,)
    assert {leg for _, legs in robot.published for leg in legs} == {"2"}


def test_a_gateway_that_was_restarted_is_noticed_by_its_first_state(robot: Robot, stream: Stream) -> None:
    robot.running = set()
    robot.publish_state()
    with pytest.raises(StoppedError):
        stream.set({1: POSE})
    assert robot.published == []
    stream.start_again()
    stream.set({1: POSE})
    assert robot.running == {1}
    asked = robot.questions
    stream.set({1: POSE})
    assert robot.questions == asked, "one answer was enough"


def test_a_start_that_only_the_whole_robot_has_says_what_to_send_in_its_place(
    monkeypatch: pytest.MonkeyPatch, robot: Any
) -> None:
    whole = Ack(accepted=False, reason=Reason.WHOLE_ROBOT, detail="this robot starts as a whole")
    monkeypatch.setattr(robot, "ask", lambda *_, **__: whole)
    with Stream(robot, HZ) as stream:
        for _ in range(2):
            with pytest.raises(RejectedError, match="whole_robot: this robot starts as a whole") as raised:
                stream.set({1: POSE})
            assert raised.value.__notes__ == [WHOLE]
    assert robot.published == []


def test_a_program_whose_setpoints_take_a_leg_from_another_one_is_warned_once(robot: Robot, stream: Stream) -> None:
    """Both take it from each other in turns, so both are warned. Another one's Stop takes it only once."""
    for source, leg in ((robot.name, 4), ("bert", 2)):
        robot.publish_event(event(Kind.SOURCE_CHANGED, "another", source).model_copy(update={"legs": (leg,)}))
        stream.set({1: POSE, 2: POSE})
    changed = event(Kind.SOURCE_CHANGED, "leg 2 is commanded by anna's laptop, and was by bert", robot.name)
    robot.publish_event(changed.model_copy(update={"legs": (2,)}))
    with pytest.warns(UserWarning, match="leg 2 is commanded by anna's laptop, and was by bert; both may") as warned:
        stream.set({1: POSE, 2: POSE})
    assert warned[0].filename == __file__, "the program's own line"
    robot.publish_event(changed.model_copy(update={"legs": (2,)}))
    stream.set({1: POSE, 2: POSE})


@pytest.mark.parametrize("kind", [Kind.CONTROLLER_SILENT, Kind.FALLEN])
def test_what_stops_a_robot_that_measures_ends_it_by_its_event(robot: Robot, stream: Stream, kind: Kind) -> None:
    robot.publish_event(event(kind, "why it stops").model_copy(update={"time": WALL + timedelta(hours=1)}))
    with pytest.raises(StoppedError, match="why it stops"):
        stream.set({1: POSE})
    assert robot.questions == 0


def test_a_controller_that_fell_silent_is_named_where_its_event_was_lost(robot: Robot, stream: Stream) -> None:
    silent = {"mode": Mode.BUS_FAULT, "controller": ControllerReport(protocol="elkapod-2025", alive=False)}
    robot.running.clear()
    robot.changed = silent
    robot.publish_state()
    with pytest.raises(StoppedError, match="the controller fell silent"):
        stream.set({1: POSE})


@pytest.mark.parametrize(
    ("kind", "detail", "sentence"),
    [
        (
            Kind.ESTOP_ENGAGED,
            "emergency stop; all is rejected until a reset",
            "the emergency stop was engaged by somebody",
        ),
        (Kind.WATCHDOG_EXPIRED, "leg 3 was not heard for 250 ms; it is stopped", "leg 3 was not heard for 250 ms"),
        (Kind.STOPPING, "the gateway ends; all servos are stopped", "the gateway ends"),
        (Kind.BUS_FAULT, "write failed; tried again", "write failed; tried again"),
    ],
)
def test_what_happened_is_said_without_what_held_from_then_on(kind: Kind, detail: str, sentence: str) -> None:
    assert happened(event(kind, detail)) == sentence
