"""elkapod-2025: what is said when, and whether the controller is alive."""

import time
from collections.abc import Callable, Collection, Iterable
from contextlib import nullcontext
from typing import Any, Final

import pytest

from gateway.errors import SpiError
from gateway.host import realtime
from gateway.model import elkapod
from gateway.model.elkapod import SHUTDOWN, START, Measured
from gateway.model.frames import SETS, STARTS, STOP, Frame, OneLeg, OneServo, stop_leg
from gateway.robot.protocol.elkapod import Commanded, SignsOfLife
from gateway.robot.spi import BatchReport, DuplexDevice
from gateway.robot.spi.cyclic import CyclicBus, run_cycles
from gateway.robot.spi.uart import Uart
from schemas.robot import LEGS, SERVO_IDS
from tests.support.bus_scenes import play
from tests.support.robot import angles_of

MS = 1_000_000
AT_REST = Measured(31.5, 7.4, 80.0, (1, 0, 0, 0), (0, 0, 0), (0, 0, 9.81), (1, 2, 3, 4, 5, 6))
STOPS = [stop_leg(leg) for leg in LEGS]


def starts(legs: Iterable[int] = LEGS, angle_cdeg: int = 80_00) -> list[Frame]:
    op = STARTS[angle_cdeg]
    return [OneLeg(leg, (op, op, op)) for leg in legs]


def angles(frame: bytes | None) -> set[float]:
    assert frame is not None
    return set(angles_of(frame).values())


# ---- what is said when


@pytest.mark.parametrize("behind", ["the first frame", "the second frame, on its way"])
def test_no_start_comes_after_a_shutdown(behind: str) -> None:
    commanded = Commanded()
    commanded.take(starts())
    commanded.frame()
    commanded.left()
    if behind != "the first frame":
        commanded.frame()
    assert commanded.shut_down() == SHUTDOWN
    said = [commanded.left()]
    for _ in range(5):
        assert angles(commanded.frame()) == {80.0}, "as they were, should the shutdown be lost"
        said += [commanded.left()]
    assert said == [None] * 6


def test_seventeen_servos_are_no_start_and_sets_are_none() -> None:
    commanded = Commanded()
    commanded.take([*starts(range(1, 6)), OneServo(61, STARTS[80_00]), OneServo(62, STARTS[80_00])])
    commanded.take([OneServo(63, SETS[80_00])])
    for _ in range(4):
        assert angles(commanded.frame()) == {80.0}
        assert commanded.left() is None


# ---- signs of life


def answered(signs: SignsOfLife, now_ns: int, answer: bytes | None = None) -> Measured | None:
    values = AT_REST._replace(temperature_c=now_ns / 1e9)
    return signs.answered(elkapod.answer(values) if answer is None else answer, now_ns)


BAD = {
    "zeros": bytes(80),
    "shifted": elkapod.answer(AT_REST)[1:] + b"\0",
    "short": elkapod.answer(AT_REST)[:-1],
    "NaN": elkapod.answer(AT_REST._replace(voltage_v=float("nan"))),
}


@pytest.mark.parametrize("bad", BAD)
def test_what_is_no_answer_is_none_and_says_why(bad: str) -> None:
    signs = SignsOfLife(0)
    assert answered(signs, 10 * MS) is not None
    for now_ms in range(20, 310, 20):
        signs.receive(elkapod.heartbeat(), now_ms * MS)
        assert answered(signs, now_ms * MS, BAD[bad]) is None
        assert signs.silent(now_ms * MS) is None
    assert "no well-formed answer of the controller for 300 ms (the last one: it " in str(signs.silent(310 * MS))


def judged(signs: SignsOfLife, values: Iterable[Measured], begun_ms: int = 0) -> list[bool]:
    """Return which of these answers, one in each cycle, counts as a measurement; heartbeats come all the time."""
    taken = []
    for cycle, each in enumerate(values, 1):
        now_ns = (begun_ms + 20 * cycle) * MS
        signs.receive(elkapod.heartbeat(), now_ns)
        taken += [answered(signs, now_ns, elkapod.answer(each)) is not None]
    return taken


def noisy(cycles: int, first: int = 0) -> list[Measured]:
    """Return answers of a robot at rest, whose gyroscope is never without noise."""
    return [AT_REST._replace(angular_velocity_rad_s=(0.001 * each, 0, 0)) for each in range(first, first + cycles)]


def test_what_has_changed_and_then_does_not_for_half_a_second_is_frozen() -> None:
    """Also where the first answer came late."""
    signs = SignsOfLife(0)
    assert judged(signs, [*noisy(50), *noisy(1, 49) * 40], 1000) == [True] * 74 + [False] * 16
    why = "(the last one: it has not changed for 500 ms)"
    assert str(signs.silent(2800 * MS)).endswith(why)
    assert judged(signs, noisy(100, 50), 2800) == [True] * 100, "and counts again once it changes"
    assert judged(signs, noisy(1, 149) * 40, 4800).count(False) == 16, "as often as it freezes"


@pytest.mark.parametrize("change", [{"temperature_c": 32.0}, {"feet": (1, 2, 3, 4, 5, 7)}], ids=["first", "last"])
def test_each_value_is_evidence(change: dict[str, Any]) -> None:
    two = [AT_REST, AT_REST._replace(**change)]
    assert judged(SignsOfLife(0), [*two * 25, *two[1:] * 40]).count(False) == 16


QUIET = {
    "nothing ever changes": [AT_REST] * 500,
    "a battery that empties": [AT_REST._replace(voltage_v=7.4 - each // 100 / 10) for each in range(500)],
    "feet while it walks, and then none": [
        AT_REST._replace(feet=(min(each, 400) if each > 100 else 0, 2, 3, 4, 5, 6)) for each in range(600)
    ],
    "a sensor that fails while the battery empties": [
        each._replace(voltage_v=7.4 - place // 20 / 100)
        for place, each in enumerate([*noisy(100), *noisy(1, 99) * 400])
    ],
}


@pytest.mark.parametrize("quiet", QUIET)
def test_a_robot_whose_values_rest_is_alive(quiet: str) -> None:
    signs = SignsOfLife(0)
    assert all(judged(signs, QUIET[quiet]))
    assert signs.restarted == ""


# ---- whether it has restarted


def beaten(
    signs: SignsOfLife, until_ms: int, begun_ms: int = 0, *, without: Collection[int] = (), late: int = 0
) -> None:
    """Send heartbeats each 50 ms but `without` these, polled in each cycle. `late`: ms of a late cycle."""
    came_ms = [at_ms for at_ms in range(50, 100_000, 50) if at_ms not in without]
    seen_ms = begun_ms
    for cycle_ms in range(begun_ms + 20, until_ms, 20):
        now_ms = cycle_ms + (late if cycle_ms % 400 == 0 else 0)
        count = sum(seen_ms < at_ms <= now_ms for at_ms in came_ms)
        seen_ms = now_ms
        signs.receive(elkapod.heartbeat() * count, now_ms * MS)


@pytest.mark.parametrize(
    ("without", "restarted"),
    [((), False), ((1000,), False), ((1000, 1100, 1200), False), ((1000, 1050), True), (range(1000, 2000), True)],
    ids=["none", "one", "each second one", "two", "a second"],
)
def test_two_missing_heartbeats_are_a_restart_and_one_is_none(without: Collection[int], *, restarted: bool) -> None:
    signs = SignsOfLife(0)
    beaten(signs, 2000, without=without)
    assert bool(signs.restarted) is restarted


def test_a_gap_is_noticed_before_the_controller_counts_as_silent() -> None:
    signs = SignsOfLife(0)
    beaten(signs, 1100, without=range(1000, 2000))
    assert signs.restarted == ""
    beaten(signs, 1140, 1080, without=range(1000, 2000))
    assert signs.restarted, "some 130 ms behind the last one"


@pytest.mark.parametrize("kept", [True, False], ids=["what came is read", "the whole machine stood still"])
@pytest.mark.parametrize("paused_ms", [80, 150, 3000])
def test_a_pause_of_ours_is_no_restart(paused_ms: int, *, kept: bool) -> None:
    signs = SignsOfLife(0)
    beaten(signs, 1010)
    now_ms = 1000 + paused_ms
    signs.receive(elkapod.heartbeat() * (paused_ms // 50 if kept else 0), now_ms * MS)
    for cycle in range(1, 60):
        signs.receive(elkapod.heartbeat() * (cycle % 3 != 0), (now_ms + cycle * 20) * MS)
    assert signs.restarted == ""
    for cycle in range(60, 70):
        signs.receive(b"", (now_ms + cycle * 20) * MS)
    assert signs.restarted, "but the next gap is one"


# ---- the bus: SPI and UART, neither waiting for the other


class Parts(Uart):
    """Both sides of a controller, which fail as the test sets them to."""

    def __init__(self, **more: bool) -> None:
        self.said: list[bytes] = []
        self.now_ns = 0
        self.opened = self.closed = 0
        self.write_takes_ns = 0
        self.answers: list[bytes] = []
        self.frame: bytes | None = None
        self.report = BatchReport()
        self.error: Exception | None = None
        self.takes_ns = 0
        """What a transfer takes."""
        self.during: list[str] = []
        """What is done during the next transfer."""
        self.meanwhile: tuple[str | None, int] = ("", 0)
        """What was found of other programs during the last transfer, and what had been closed."""
        self.failing: set[str] = set()
        """What fails: `spi`, `uart` (also its opening), `writing`, `reading`."""
        self.beats = False
        self.bus = CyclicBus(
            self._open,
            self._open_uart,
            clock=lambda: self.now_ns,
            **more,
        )

    def _fail(self, what: str, sentence: str) -> None:
        if what in self.failing:
            raise SpiError(sentence)

    def _open(self) -> DuplexDevice:
        self._fail("spi", "no SPI")
        self.opened += 1
        return Opened(self)

    def _open_uart(self) -> Uart:
        self._fail("uart", "no UART")
        return self

    def write(self, data: bytes) -> None:
        self._fail("uart", "hung up")
        self._fail("writing", "hung up")
        self.now_ns += self.write_takes_ns
        self.said.append(data)

    def read(self) -> bytes:
        self._fail("reading", "disconnected")
        return elkapod.heartbeat() if self.beats else b""

    def close(self) -> None:
        self.closed += 1

    # ---- scenes

    def play(self, scene: str) -> "Parts":
        return play(self, scene, DONE, Parts._made, FACTS)

    def _made(self) -> list[str]:
        """Return what the UART said."""
        said, self.said = self.said, []
        return [{START: "start", SHUTDOWN: "shutdown"}[each] for each in said]

    def try_to(self, do: Callable[[], object]) -> None:
        try:
            do()
        except SpiError as error:
            self.error = error

    def go(self) -> None:
        """Do one cycle now."""
        self.frame = None
        self.bus.cycle(nullcontext(), lambda _values, _ns: None, lambda fault: setattr(self, "error", fault))

    def cycles(self, number: int) -> None:
        """Do so many cycles, each 20 ms after the last."""
        for _ in range(number):
            self.now_ns += 20 * MS
            self.go()

    def wait(self, until_ms: float) -> None:
        """Ask in each cycle whether it is silent, until it is, while no frame is exchanged."""
        while self.now_ns < until_ms * MS and self.error is None:
            self.now_ns += 20 * MS
            self.error = self.bus.silent(self.now_ns)

    @property
    def fault(self) -> str | None:
        """Return what was raised or reported since the last call."""
        found, self.error = self.error or self.report.fault, None
        self.report = BatchReport()
        return None if found is None else f"{type(found).__name__}: {found}"


class Opened(DuplexDevice):
    """One opening of the device."""

    def __init__(self, parts: Parts) -> None:
        self._parts = parts

    def stop_servos_at_work(self) -> bool:
        return True

    def put_right(self) -> str | None:
        return "mode 0"

    def exchange(self, data: bytes) -> bytes:
        parts = self._parts
        parts.frame, during, parts.during = data, parts.during, []
        for what in during:
            DONE[what](parts, "")
        parts.now_ns += parts.takes_ns
        parts.meanwhile = parts.bus.put_right(), parts.closed
        parts._fail("spi", "timed out")
        if parts.answers:
            return parts.answers.pop()
        return elkapod.answer(AT_REST._replace(temperature_c=parts.now_ns / 1e9))

    def close(self) -> None:
        self._parts.closed += 1


DONE: Final[dict[str, Callable[[Parts, str], object]]] = {
    "open": lambda parts, _: parts.try_to(parts.bus.open),
    "release": lambda parts, _: parts.bus.release(),
    "close": lambda parts, _: parts.bus.close(),
    "at": lambda parts, ms: setattr(parts, "now_ns", round(float(ms) * MS)),
    "starts": lambda parts, _: setattr(parts, "report", parts.bus.write(starts())),
    "stops": lambda parts, legs: setattr(parts, "report", parts.bus.write(STOPS[: int(legs or 6)])),
    "cycle": lambda parts, number: parts.cycles(int(number or 1)),
    "go": lambda parts, _: parts.go(),
    "takes": lambda parts, ms: setattr(parts, "takes_ns", round(float(ms) * MS)),
    "during": lambda parts, what: setattr(parts, "during", what.split()),
    "wait": lambda parts, until_ms: parts.wait(float(until_ms)),
    "silent": lambda parts, _: setattr(parts, "error", parts.bus.silent(parts.now_ns)),
    "fails": lambda parts, what: parts.failing.update(what.split()),
    "works": lambda parts, _: parts.failing.clear(),
    "beats": lambda parts, word: setattr(parts, "beats", word == "on"),
    "answers": lambda parts, _: setattr(parts, "answers", [bytes(80)]),  # as a controller that has just begun
}
FACTS: Final[dict[str, Callable[[Parts], object]]] = {
    "fault": lambda parts: parts.fault,
    "frame": lambda parts: parts.frame and angles(parts.frame),
    "alive": lambda parts: parts.bus.controller_alive,
    "opened": lambda parts: parts.opened,
    "closed": lambda parts: parts.closed,
    "errors": lambda parts: parts.bus.errors,
    "frames": lambda parts: parts.bus.frames,
    "received": lambda parts: [sent.received for sent in parts.report.sent],
    "meanwhile": lambda parts: parts.meanwhile,
    "longest": lambda parts: parts.bus.transfer_latency.max_us,
    "found": lambda parts: parts.bus.put_right(),
    "at-work": lambda parts: parts.bus.stop_servos_at_work(),
    "ready": lambda parts: len(parts.bus.ready_servos(dict.fromkeys(SERVO_IDS))),
}
SCENES: Final = {
    "it begins with shutdowns and only then with frames": """
        open → shutdown
        cycle 3 → nothing; frame None
        cycle → nothing; frame {90.0}""",
    "the first frame leaves when its time has come": """
        open; at 69.999999; go → shutdown; frame None
        at 70; go → nothing; frame {90.0}""",
    "a transfer that hangs delays no stop and its start does not come": """
        open; at 100; starts; cycle → shutdown
        takes 300; during stops; cycle → shutdown; meanwhile (None, 0); found mode 0; frames 2; longest 300000.0""",
    "a failed transfer shuts down at once and the device opens anew": """
        open; at 100; starts; fails spi; cycle → shutdown shutdown; fault timed out; closed 1  # the UART stays open
        open → shutdown; fault no SPI
        works; open; cycle 10 → shutdown""",
    "no device is closed in the middle of a transfer": """
        open; at 100; during release; cycle → shutdown; frame {90.0}; meanwhile (None, 0); closed 1; frames 0
        open → shutdown; opened 2
        at 200; during release open; cycle → shutdown; meanwhile (None, 1); closed 2; opened 3; frames 0
        cycle 4 → nothing; frames 1""",
    "a uart that fails opens anew and begins with a shutdown": """
        open; fails uart; stops → shutdown; fault hung up
        stops → nothing; fault closed
        open → nothing; fault no UART
        works; open → shutdown""",
    "a silent controller is shut down and counts as back when both signs are": """
        open; beats on; cycle 4 → shutdown; frame {90.0}; alive True
        beats off; cycle 14 → nothing
        cycle 1 → shutdown; fault no heartbeat
        silent → nothing; alive False  # reported once
        release → nothing; closed 0  # its signs of life would come there
        open → shutdown; fault no heartbeat
        beats on; cycle; open → shutdown; alive True""",
    "a restart is shut down in its cycle and nothing that waited is started": """
        open; beats on; at 100; cycle; starts; cycle → shutdown
        answers; cycle → shutdown; fault ControllerRestartedError: the controller; alive False
        release → nothing; closed 0
        open → shutdown; fault it goes from 00 to 00
        cycle; open → shutdown; alive True
        cycle 4 → nothing; frame {80.0}; errors 1  # counted once""",
    "a uart that hangs up is found by the cycle": """
        open; at 100; fails reading; cycle → shutdown; fault disconnected; closed 1; errors 1
        works; open → shutdown""",
    "a shutdown that cannot be said opens the uart anew": """
        open; at 100; fails spi uart; cycle → shutdown; fault timed out; closed 2""",
    "an opening that cannot shut down fails": "open; fails writing; open → shutdown; fault hung up; closed 1",
    "the end releases both": """
        open; close → shutdown; closed 2
        close → nothing; closed 2""",
    "other programs are seen on the device": """
        at 0 → nothing; found None; at-work None
        open → shutdown; found mode 0; at-work True""",
    "each fault is counted once": """
        fails uart; open → nothing; fault no UART; errors 1
        works; fails spi; open → shutdown; fault no SPI; errors 2
        works; open; fails uart; stops → shutdown; fault hung up; errors 3
        works; open; at 100; fails spi; cycle → shutdown shutdown; fault timed out; errors 4
        release; works; open; wait 1000 → shutdown shutdown; fault ControllerSilentError; errors 5""",
    "a process that was delayed takes no controller for silent": """
        open; at 100; silent; at 400; silent → shutdown
        at 699.999; silent → shutdown; fault no well-formed answer""",
    "a device that came back has its time to answer": """
        open; at 100; fails spi; cycle → shutdown shutdown; fault timed out
        release; works; at 5000; open; wait 5360 → shutdown
        at 5369; silent → nothing
        at 5370; silent → shutdown; fault (the last one: none has come)
        release → nothing; closed 1  # its signs of life would come there""",
    "a device that fails while the controller is silent opens anew": """
        open; wait 400 → shutdown shutdown; fault ControllerSilentError
        fails spi; cycle → shutdown; fault timed out
        release → nothing; closed 1
        works; open → shutdown; fault no well-formed answer; opened 2""",
    "a stop of one leg shuts down all": """
        open; at 100; starts; cycle 2; stops 1 → shutdown start shutdown; received [True]; ready 0""",
}


@pytest.mark.parametrize("scene", SCENES.values(), ids=SCENES)
def test_a_scene(scene: str) -> None:
    Parts().play(scene)


def test_without_a_device_only_stops_are_written() -> None:
    parts = Parts()
    bus = CyclicBus(None, lambda: parts)
    assert bus.answered_ns is None
    bus.open()
    assert bus.write(STOPS, preamble=True).fault is None
    assert parts.said == [SHUTDOWN] * 2
    assert "closed" in str(bus.write(starts()).fault)
    bus.close()


def test_when_it_left_and_how_long_it_took() -> None:
    parts = Parts().play("open; at 100")
    parts.write_takes_ns = 50_000
    stops = parts.bus.write(STOPS).sent[0]
    assert (stops.ns, stops.call_ns) == (100 * MS + 50_000, 50_000)
    moves = parts.bus.write(starts()).sent[0]
    assert (moves.ns, moves.call_ns) == (100 * MS + 50_000, 0)
    assert [sent.places for sent in parts.bus.write(STOPS).sent] == [range(6)]


def test_a_late_cycle_is_not_made_up_for(monkeypatch: pytest.MonkeyPatch) -> None:
    parts, begun_ms, takes_ms = Parts(), list[float](), iter((1, 45, 1, 1))

    def cycle() -> None:
        begun_ms.append(parts.now_ns / MS)
        parts.now_ns += next(takes_ms) * MS

    monkeypatch.setattr(realtime, "prefer_thread", lambda priority: begun_ms.append(-priority))
    monkeypatch.setattr(time, "sleep", lambda s: setattr(parts, "now_ns", parts.now_ns + round(s * 1e9)))
    with pytest.raises(StopIteration):
        run_cycles(cycle, lambda: parts.now_ns)
    assert begun_ms == [-realtime.LOOP_PRIORITY, 0, 20, 65, 85, 105]


# ---- with a power board that feeds each servo: which may be fed, and when the UART speaks


def one(servo_id: int, angle_cdeg: int = 80_00) -> Frame:
    return OneServo(servo_id, STARTS[angle_cdeg])


@pytest.fixture
def commanded() -> Commanded:
    return Commanded(fed_singly=True)


def cycle(commanded: Commanded) -> bytes | None:
    """Send a frame, and return the UART's output after it."""
    commanded.frame()
    return commanded.left()


def test_a_stop_of_one_is_the_boards_alone_while_others_run_or_wait(commanded: Commanded) -> None:
    commanded.take([one(11), one(12)])
    assert commanded.stop([12]) is None, "11 waits"
    assert [cycle(commanded) for _ in range(3)] == [None, START, None]
    assert commanded.ready == {11}, "12 does not come after its Stop"
    commanded.take([one(12)])
    assert commanded.stop([12]) is None, "11 runs"
    assert commanded.stop([11]) == SHUTDOWN, "the last one"
    assert commanded.ready == frozenset()


def test_a_stop_in_the_middle_of_a_transfer_stops_what_the_frame_would_start(commanded: Commanded) -> None:
    commanded.take([one(11), one(12)])
    cycle(commanded)
    commanded.frame()
    commanded.stop([11])
    assert commanded.left() == START
    assert commanded.ready == {12}


def test_a_start_with_another_angle_in_the_middle_of_a_transfer_counts_its_own_frames(commanded: Commanded) -> None:
    commanded.take([one(11, 80_00)])
    commanded.frame()
    commanded.take([one(11, 70_00)])
    said = [commanded.left(), cycle(commanded)]
    assert (said, commanded.ready) == ([None, None], frozenset()), "70 degrees were in one frame"
    assert (cycle(commanded), commanded.ready) == (START, frozenset({11}))


def test_a_servo_that_is_to_be_fed_is_prepared_and_one_that_is_not_any_more_begins_anew(commanded: Commanded) -> None:
    assert commanded.prepare({11: 80_00, 12: None}) == frozenset()
    assert [cycle(commanded), cycle(commanded)] == [None, START]
    assert commanded.prepare({11: 80_00, 12: None}) == {11}
    commanded.take([one(11, 70_00)])
    assert cycle(commanded) is None, "its start has been said"
    assert commanded.prepare({12: None}) == frozenset()
    assert commanded.prepare({11: 60_00}) == frozenset()
    assert [cycle(commanded), cycle(commanded)] == [None, START], "two frames with its new angle"
    assert commanded.prepare({11: 60_00}) == {11}
    commanded.prepare({11: None, 13: 60_00})
    commanded.prepare({11: None})
    assert [cycle(commanded), cycle(commanded)] == [None, None], "13 is not to be fed any more"


def test_a_servo_that_does_not_run_keeps_its_angle_in_a_frame_about_others(commanded: Commanded) -> None:
    commanded.take([one(11, 70_00)])
    commanded.take([OneLeg(1, (STOP, STARTS[80_00], STARTS[80_00]))])
    assert [*angles_of(commanded.frame()).values()][:3] == [70, 80, 80]


def test_the_board_stops_one_leg_and_the_others_go_on() -> None:
    Parts(fed_singly=True).play("""
        open; at 100; starts; cycle 2; stops 1 → shutdown start; received [True]; ready 15""")
