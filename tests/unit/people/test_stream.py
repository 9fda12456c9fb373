"""What a stream makes of a gateway's silence, its end and its watchdog, in virtual time: no thread, no gateway."""

from collections.abc import Callable, Iterator, Mapping
from datetime import timedelta
from types import SimpleNamespace
from typing import Any, Final, Self

import pytest

from gateway.errors import DisconnectedError, GatewayError, RejectedError, StoppedError, UnansweredError
from gateway.geometry import load
from gateway.people.client.pace import SILENCE_S
from gateway.people.client.stopped import AGAIN, DECIDES, STOP
from gateway.people.client.stream import WHOLE, Stream
from gateway.people.ros2.joints import JointsError
from gateway.people.ros2.motions import STARTS_WHOLE, JointCommands
from schemas.ack import Ack
from schemas.config import WireReport
from schemas.event import Event
from schemas.gateway_state import ControllerReport, GatewayState
from schemas.robot import LEGS, SERVO_IDS
from schemas.words import Cause, Kind, Mode, Reason
from tests.support.published import WALL, event, state

HZ = 50
PERIOD_S = 1 / HZ
POSE = (90, 45, 120)


class Robot:
    """A client and its gateway. Time passes where the stream sleeps, and where a test says so."""

    name, zid = "anna's laptop", "a1"
    carried_lease = None
    reset_command = "hexapod-gateway reset --connect tcp/192.0.2.7:7447"

    def __init__(self) -> None:
        self.open_parts: dict[object, None] = {}
        self.requests_s: list[float] = []
        """When anything was asked."""
        self.rejects: Ack | None = None
        """The answer to starts, in place of an acceptance."""
        self.now_s = 100.0
        self.connected = True
        self.answers = True
        self.published: list[tuple[float, list[str]]] = []
        self.asked: list[tuple[str, list[int]]] = []
        """A start or a Stop, and the legs of each."""
        self.questions = 0
        self.running: set[int] = set()
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

    def stream(self, hz: float) -> Stream:
        found: Any = self
        return Stream(found, hz)

    def publish(self, _key: str, payload: Mapping[str, Any]) -> None:
        self.published.append((self.now_s, list(payload["legs"])))

    def ask(self, _key: str, payload: Mapping[str, Any], *, again: bool = False) -> Ack:
        legs = {int(leg) for leg in payload["legs"]}
        self.asked.append(("stop" if again else "start", sorted(legs)))
        self.requests_s.append(self.now_s)
        if not again and not self.answers:
            raise UnansweredError("no gateway answered")
        if not again and self.rejects is not None:
            return self.rejects
        self.running = self.running - legs if again else self.running | legs
        return Ack(accepted=True)

    def state(self, _timeout_s: float = 0.0) -> GatewayState:
        self.questions += 1
        self.requests_s.append(self.now_s)
        if not self.answers:
            raise UnansweredError("no gateway answered")
        return self.report()

    # ---- the gateway's

    def report(self) -> GatewayState:
        found = state(self.now_s, running=self.running)
        legs = tuple(leg.model_copy(update={"source": self.name}) for leg in found.legs)
        return found.model_copy(update={"legs": legs, **self.changed})

    def publish_state(self) -> None:
        self._hears_state(self.report())


@pytest.fixture
def robot(monkeypatch: pytest.MonkeyPatch) -> Robot:
    found = Robot()
    for module in ("gateway.people.client.stream", "gateway.people.client.stopped", "gateway.errors"):
        monkeypatch.setattr(f"{module}.time", found)
    monkeypatch.setattr("gateway.people.client.stream.own_lease", lambda _: None)  # it lives in real time
    return found


@pytest.fixture
def stream(robot: Any) -> Iterator[Stream]:
    """Yield a stream of legs 1 and 2, just after a state."""
    with Stream(robot, HZ) as found:
        found.set({1: POSE, 2: POSE})
        robot.publish_state()
        robot.questions = 0
        yield found


def go_on(robot: Robot, stream: Stream, for_s: float, *, publishes: bool = True) -> None:
    for _ in range(round(for_s * HZ)):
        stream.set({1: POSE, 2: POSE})
        if publishes:
            robot.publish_state()


def ends(robot: Robot, stream: Stream, happens: Callable[[Robot], None]) -> GatewayError:
    happens(robot)
    with pytest.raises(GatewayError) as error:
        stream.set({1: POSE, 2: POSE})
    return error.value


def test_a_stream_sends_its_newest_pose_once_a_tick_and_asks_nothing(robot: Robot, stream: Stream) -> None:
    begun_s = robot.now_s
    go_on(robot, stream, 1.0)
    assert [sent_s - begun_s for sent_s, _ in robot.published] == pytest.approx([tick / HZ for tick in range(1, 51)])
    assert (robot.questions, stream.missed) == (0, 0)


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


def test_the_first_setpoint_of_a_leg_starts_it_and_the_end_stops_what_was_moved(robot: Any) -> None:
    robot.running = {6}
    with Stream(robot, HZ) as stream:
        stream.set({1: POSE})
        assert robot.running == {1, 6}
        stream.set({1: POSE, 4: POSE})
        assert robot.running == {1, 4, 6}
    assert robot.running == {6}


def test_a_start_that_nobody_answered_is_stopped(robot: Any) -> None:
    """It may still be on its way, and arrive later."""
    with Stream(robot, HZ) as stream:
        robot.answers = False
        with pytest.raises(UnansweredError):
            stream.set({5: POSE})
    assert robot.asked == [("start", [5]), ("stop", [5])]


def test_the_end_of_a_stream_whose_lease_is_elsewhere_stops_nothing(robot: Any) -> None:
    """Whoever was handed it, or took it, may drive these legs."""
    robot.carried_lease = SimpleNamespace(elsewhere=False, check=lambda: None)
    with Stream(robot, HZ) as stream:
        stream.set({1: POSE})
        robot.carried_lease.elsewhere = True
    assert robot.running == {1}


def test_a_start_that_only_the_whole_robot_has_says_what_to_send_in_its_place(robot: Any) -> None:
    robot.rejects = Ack(accepted=False, reason=Reason.WHOLE_ROBOT, detail="this robot starts as a whole")
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


def test_a_gait_in_radians_is_warned_of_with_its_first_setpoint(robot: Any) -> None:
    with Stream(robot, HZ) as stream:
        with pytest.warns(UserWarning, match="these look like radians") as warned:
            stream.set({1: (1.57, 0.8, 2.1)})
        assert warned[0].filename == __file__
        stream.set({1: (1.57, 0.8, 2.1)})


# ---- a program that goes on after each error


def estopped(robot: Robot) -> None:
    """Engage the emergency stop; no event is received."""
    robot.running = set()
    robot.changed = {"mode": Mode.ESTOPPED, "estop_source": "bert"}
    robot.rejects = Ack(accepted=False, reason=Reason.ESTOPPED, detail="reset it first")
    robot.publish_state()


def vanished(robot: Robot) -> None:
    """Vanish; the watchdog stops the legs."""
    robot.connected = robot.answers = False
    robot.running = set()


def stopped_and_taken(robot: Robot) -> None:
    """Stop the legs, and drive from now on as another client."""
    robot.running = set()
    robot.rejects = Ack(accepted=False, reason=Reason.NOT_HOLDER, detail="bert holds the lease")
    robot.publish_state()


@pytest.mark.parametrize("happens", [estopped, vanished, stopped_and_taken])
@pytest.mark.parametrize("starts_again", [True, False])
def test_a_program_that_goes_on_after_each_error_keeps_its_ticks_and_asks_twice_a_second(
    robot: Robot, stream: Stream, happens: Callable[[Robot], None], starts_again: bool
) -> None:
    happens(robot)
    begun_s, errors = robot.now_s, 0
    robot.requests_s.clear()
    while robot.now_s < begun_s + 10:
        before_s = robot.now_s
        with pytest.raises(GatewayError):
            stream.set({1: POSE, 2: POSE})
        errors += 1
        assert robot.now_s - before_s >= PERIOD_S / 2
        if starts_again:
            stream.start_again()
    assert errors <= 10 * HZ + 1
    asked_s = robot.requests_s
    assert all(later - earlier >= 1 for earlier, later in zip(asked_s, asked_s[2:], strict=False))
    assert len(asked_s) >= 15 if starts_again else len(asked_s) <= 1
    assert not robot.running


@pytest.mark.parametrize(
    ("happens", "sentence"),
    [
        (estopped, f"emergency stop: nothing moves until a person runs `{Robot.reset_command}`; the emergency stop was "
         "engaged by bert"),
        (vanished, "no gateway answered"),
    ],
)  # fmt: skip
def test_recover_raises_what_is_still_so_after_its_time_or_waits_for_its_end_and_the_next_set_starts(
    robot: Robot, stream: Stream, happens: Callable[[Robot], None], sentence: str
) -> None:
    first, begun_s = ends(robot, stream, happens), robot.now_s
    assert first.__notes__ == [AGAIN]
    with pytest.raises(GatewayError) as error:
        stream.recover(timeout_s=3)
    assert (str(error.value), error.value.__cause__, stream.is_over) == (sentence, first, True)
    assert robot.now_s - begun_s == pytest.approx(3, abs=PERIOD_S)
    robot.requests_s.clear()
    begun_s = robot.now_s
    monotonic = robot.monotonic

    def ended_after_4_s() -> float:
        if monotonic() >= begun_s + 4:
            robot.connected = robot.answers = True
            robot.changed, robot.rejects = {}, None
        return monotonic()

    robot.monotonic = ended_after_4_s  # type: ignore[method-assign]
    stream.recover(timeout_s=10)
    assert 4 <= robot.now_s - begun_s <= 4.5
    assert len(robot.requests_s) <= 2 * 4.5 + 1
    assert robot.asked == [("start", [1, 2])], "it neither resets nor starts"
    assert not robot.running
    stream.set({1: POSE, 2: POSE})
    assert robot.running == {1, 2}
    stream.recover(timeout_s=0)  # without an error it does nothing
    asked = robot.questions
    stream.set({1: POSE, 2: POSE})
    assert robot.questions == asked, "one answer was enough"


def test_a_start_that_an_emergency_stop_rejects_is_recovered_from_and_one_out_of_limits_is_not(robot: Any) -> None:
    with Stream(robot, HZ) as stream:
        estopped(robot)
        with pytest.raises(RejectedError, match="estopped"):
            stream.set({1: POSE})
        robot.changed = {}
        robot.rejects = Ack(accepted=False, reason=Reason.JOINT_LIMIT, detail="servo 11 may go from 0 to 80")
        stream.recover(timeout_s=10)
        with pytest.raises(RejectedError, match="joint_limit"):
            stream.set({1: POSE})
        with pytest.raises(RejectedError, match="joint_limit"):
            stream.recover(timeout_s=10)
        robot.rejects = None
        stream.start_again()
        stream.set({1: POSE})
        assert robot.running == {1}


def newer(kind: Kind, detail: str, source: str | None = None, *legs: int) -> Event:
    return event(kind, detail, source).model_copy(update={"time": WALL + timedelta(hours=1), "legs": legs})


def by(who: str | None) -> Callable[[Robot], None]:
    """Return a Stop of all legs by this source, of which only the state informs."""

    def happens(robot: Robot) -> None:
        robot.running = set()
        robot.changed = {"legs": tuple(leg.model_copy(update={"source": who}) for leg in robot.report().legs)}
        robot.publish_state()

    return happens


def by_bert(robot: Robot) -> None:
    """Stop all legs as Bert, 0.2 s ago."""
    halted = newer(Kind.LEGS_STOPPED, "bert stopped all legs", "bert", *LEGS)
    robot.publish_event(halted.model_copy(update={"cause": Cause.COMMAND}))
    robot.now_s += 0.2
    by("bert")(robot)


def test_recover_undoes_nobodys_stop(robot: Robot, stream: Stream) -> None:
    error = ends(robot, stream, by_bert)
    assert error.__notes__ == [DECIDES]
    robot.changed = {}
    requests, begun_s = len(robot.requests_s), robot.now_s
    with pytest.raises(StoppedError, match="bert stopped"):
        stream.recover(timeout_s=100)
    assert (len(robot.requests_s), robot.now_s) == (requests, begun_s)
    robot.now_s += 3
    assert str(error) == "bert stopped legs 1 and 2, 3.2 s ago", "when it is shown again"


# ---- who, what, which legs, and how long ago


def told(*events: Event) -> Callable[[Robot], None]:
    """Return a gateway's events, 0.1 s ago."""

    def happens(robot: Robot) -> None:
        for each in events:
            robot.publish_event(each)
        robot.now_s += 0.1 - PERIOD_S

    return happens


def fell_silent(robot: Robot) -> None:
    """Let the controller fall silent, and lose its event."""
    robot.running.clear()
    robot.changed = {"mode": Mode.BUS_FAULT, "controller": ControllerReport(alive=False)}
    robot.publish_state()


BUTTON = newer(Kind.ESTOP_ENGAGED, "all is rejected until a reset")
BERTS = newer(Kind.ESTOP_ENGAGED, "emergency stop", "bert", 1, 2)
FELL = newer(Kind.FALLEN, "the robot has fallen", None, 1, 2)
EXPIRED = [newer(Kind.WATCHDOG_EXPIRED, f"no command for leg {leg} in 250 ms", None, leg) for leg in LEGS]
AGO = ", 0.1 s ago"


@pytest.mark.parametrize(
    ("happens", "sentence", "who", "cause"),
    [
        (told(newer(Kind.CONTROLLER_SILENT, "it is silent")), f"it is silent{AGO}", None, "controller_silent"),
        (told(newer(Kind.BUS_FAULT, "failed; tried again")), f"failed; tried again{AGO}", None, "bus_fault"),
        (told(newer(Kind.STOPPING, "the gateway ends; all stop")), f"the gateway ends{AGO}", None, "stopping"),
        (told(BUTTON), f"the emergency stop was engaged by somebody{AGO}", None, "estop_engaged"),
        (told(*EXPIRED), f"the watchdog stopped all legs (no command in 250 ms){AGO}", None, "watchdog_expired"),
        # each cause once, and the one that a person decides about counts
        (told(BERTS, FELL, FELL), f"the emergency stop was engaged by bert; the robot has fallen{AGO}", None, "fallen"),
        # no event was received: the state is asked for
        (fell_silent, "the controller fell silent", None, "controller_silent"),
        (by_bert, "bert stopped all legs, 0.2 s ago", "bert", STOP),
        (by("anna's laptop"), "anna's laptop (this program) stopped all legs", "anna's laptop", STOP),
        (by(None), "the gateway, or somebody without a name, stopped all legs", None, STOP),
    ],
)
def test_what_stops_it_is_named_with_its_source_and_its_time(
    robot: Any, happens: Callable[[Robot], None], sentence: str, who: str | None, cause: str
) -> None:
    with Stream(robot, HZ) as stream:
        stream.set([POSE] * 6)
        robot.questions = 0
        error = ends(robot, stream, happens)
    assert isinstance(error, StoppedError)
    assert (str(error), error.by, error.cause) == (sentence, who, cause)
    assert error.legs == ((1, 2) if cause == "fallen" else tuple(LEGS))
    assert error.lasting == sentence.partition(", 0.")[0]
    assert robot.questions == (", 0." not in sentence), "events decide without a question"


def test_a_stream_reports_its_jitter_and_a_short_repr(robot: Robot, stream: Stream) -> None:
    go_on(robot, stream, 1.0)
    assert stream.jitter.max_ms < 1
    robot.now_s += 1.4 * PERIOD_S
    stream.set({1: POSE, 2: POSE})
    assert stream.jitter.p50_ms < 1
    assert stream.jitter.max_ms == pytest.approx(0.4 * PERIOD_S * 1000, abs=1e-3)
    assert repr(stream) == "<Stream 50 Hz, open, legs 1 and 2 started, 0 missed>"


# ---- the bridge's motions on a robot that starts as a whole: all six legs at once


GEOMETRY: Final = load()
ALL_RAD: Final = {servo_id: GEOMETRY.joint_rad(servo_id, 90) for servo_id in SERVO_IDS}
ONE_LEG_RAD: Final = {servo_id: at for servo_id, at in ALL_RAD.items() if servo_id < 20}


@pytest.fixture
def whole(robot: Robot) -> Any:
    robot.changed = {"wire": WireReport(name="any", whole_robot=True)}
    return robot


def test_joint_commands_start_all_legs_at_once_and_a_message_with_fewer_starts_none(whole: Any) -> None:
    motion = JointCommands(whole, GEOMETRY)
    with pytest.raises(JointsError, match=STARTS_WHOLE):
        motion.command(ONE_LEG_RAD)
    motion.command(ALL_RAD)
    motion.command(ONE_LEG_RAD)  # what runs is not started again
    motion.end(sits=False)
    assert whole.asked == [("start", list(LEGS)), ("stop", list(LEGS))]
