"""elkapod-2025: what is said when, and whether the controller is alive."""

from collections.abc import Collection, Iterable

import pytest

from gateway.errors import ControllerRestartedError, ControllerSilentError, SpiError
from gateway.model import elkapod
from gateway.model.elkapod import SHUTDOWN, START, Measured
from gateway.model.frames import SETS, STARTS, Frame, OneLeg, OneServo, stop_leg
from gateway.robot.protocol.elkapod import Commanded, SignsOfLife
from gateway.robot.spi import DuplexDevice
from gateway.robot.spi.cyclic import CyclicBus
from gateway.robot.spi.guard import IllegalTransferError
from gateway.robot.spi.uart import Uart
from schemas.robot import LEGS, SERVO_IDS

MS = 1_000_000
SILENT_NS = 300 * MS
AT_REST = Measured(31.5, 7.4, 80.0, (1, 0, 0, 0), (0, 0, 0), (0, 0, 9.81), (1, 2, 3, 4, 5, 6))
STOPS = [stop_leg(leg) for leg in LEGS]


def starts(legs: Iterable[int] = LEGS, angle_cdeg: int = 80_00) -> list[Frame]:
    op = STARTS[angle_cdeg]
    return [OneLeg(leg, (op, op, op)) for leg in legs]


def angles(frame: bytes | None) -> set[float]:
    assert frame is not None
    return set(elkapod.angles_of(frame).values())


# ---- what is said when


def test_a_whole_start_has_its_angles_in_two_frames_before_the_uarts_start() -> None:
    commanded = Commanded()
    assert angles(commanded.frame()) == {90.0}
    assert commanded.left() is None
    commanded.take(starts())
    assert angles(commanded.frame()) == {80.0}
    assert commanded.left() is None
    assert commanded.frame()
    assert commanded.left() == START
    assert commanded.frame()
    assert commanded.left() is None, "once"


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
    "FF": b"\xff" * 80,
    "shifted": elkapod.answer(AT_REST)[1:] + b"\0",
    "short": elkapod.answer(AT_REST)[:-1],
    "NaN": elkapod.answer(AT_REST._replace(voltage_v=float("nan"))),
    "infinite": elkapod.answer(AT_REST._replace(orientation_wxyz=(1.0, 0.0, 0.0, float("inf")))),
}


@pytest.mark.parametrize("bad", BAD)
def test_what_is_no_answer_is_none_and_says_why(bad: str) -> None:
    signs = SignsOfLife(SILENT_NS, 0)
    assert answered(signs, 10 * MS) is not None
    for now_ms in range(20, 310, 20):
        signs.receive(elkapod.heartbeat(), now_ms * MS)
        assert answered(signs, now_ms * MS, BAD[bad]) is None
        assert signs.silent(now_ms * MS) is None
    assert "no well-formed answer of the controller for 300 ms (the last one: it " in str(signs.silent(310 * MS))


def judged(signs: SignsOfLife, values: Iterable[Measured], begun_ms: int = 0) -> list[bool]:
    """Which of these answers, one in each cycle, counts as a measurement; heartbeats come all the time."""
    taken = []
    for cycle, each in enumerate(values, 1):
        now_ns = (begun_ms + 20 * cycle) * MS
        signs.receive(elkapod.heartbeat(), now_ns)
        taken += [answered(signs, now_ns, elkapod.answer(each)) is not None]
    return taken


def noisy(cycles: int, first: int = 0) -> list[Measured]:
    """Answers of a robot at rest, whose gyroscope is never without noise."""
    return [AT_REST._replace(angular_velocity_rad_s=(0.001 * each, 0, 0)) for each in range(first, first + cycles)]


def test_what_has_changed_and_then_does_not_for_half_a_second_is_frozen() -> None:
    signs = SignsOfLife(SILENT_NS, 0)
    assert judged(signs, [*noisy(50), *noisy(1, 49) * 40]) == [True] * 74 + [False] * 16
    now_ns = 90 * 20 * MS
    why = "(the last one: it has not changed for 500 ms)"
    assert str(signs.silent(now_ns)).endswith(why)
    assert judged(signs, noisy(100, 50), 1800) == [True] * 100, "and counts again once it changes"
    assert judged(signs, noisy(1, 149) * 40, 3800).count(False) == 16, "as often as it freezes"


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
    signs = SignsOfLife(SILENT_NS, 0)
    assert all(judged(signs, QUIET[quiet]))
    assert signs.restarted == ""


# ---- whether it has restarted


def beaten(
    signs: SignsOfLife, until_ms: int, begun_ms: int = 0, *, without: Collection[int] = (), late: int = 0
) -> None:
    """Heartbeats of each 50 ms but `without` these, looked for in each cycle; `late`: whose cycle came late, in ms."""
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
    signs = SignsOfLife(SILENT_NS, 0)
    beaten(signs, 2000, without=without)
    assert bool(signs.restarted) is restarted


def test_a_gap_is_noticed_before_the_controller_counts_as_silent() -> None:
    signs = SignsOfLife(SILENT_NS, 0)
    beaten(signs, 1100, without=range(1000, 2000))
    assert signs.restarted == ""
    beaten(signs, 1140, 1080, without=range(1000, 2000))
    assert signs.restarted, "some 130 ms behind the last one"


@pytest.mark.parametrize("kept", [True, False], ids=["what came is read", "the whole machine stood still"])
@pytest.mark.parametrize("paused_ms", [80, 150, 3000])
def test_a_pause_of_ours_is_no_restart(paused_ms: int, *, kept: bool) -> None:
    signs = SignsOfLife(SILENT_NS, 0)
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


class Parts(DuplexDevice, Uart):
    """Both sides of a controller, which fail as the test sets them to."""

    def __init__(self, **more: bool) -> None:
        self.said: list[bytes] = []
        self.now_ns = 0
        self.opened = self.closed = 0
        self.write_takes_ns = 0
        self.answers: list[bytes] = []
        self.spi_fails = self.uart_fails = self.write_fails = self.hangs_up = self.beats = False
        self.bus = CyclicBus(
            self._open,
            self._open_uart,
            silent_ns=SILENT_NS,
            before_frames_ns=70 * MS,
            clock=lambda: self.now_ns,
            **more,
        )

    def _open(self) -> DuplexDevice:
        if self.spi_fails:
            raise SpiError("no SPI")
        self.opened += 1
        return self

    def _open_uart(self) -> Uart:
        if self.uart_fails:
            raise SpiError("no UART")
        return self

    def stop_servos_at_work(self) -> bool:
        return True

    def put_right(self) -> str | None:
        return "mode 0"

    def exchange(self, _data: bytes) -> bytes:
        if self.spi_fails:
            raise SpiError("timed out")
        if self.answers:
            return self.answers.pop()
        return elkapod.answer(AT_REST._replace(temperature_c=self.now_ns / 1e9))

    def write(self, data: bytes) -> None:
        if self.uart_fails or self.write_fails:
            raise SpiError("hung up")
        self.now_ns += self.write_takes_ns
        self.said.append(data)

    def read(self) -> bytes:
        if self.hangs_up:
            raise SpiError("disconnected")
        return elkapod.heartbeat() if self.beats else b""

    def close(self) -> None:
        self.closed += 1

    def wait(self, until_ms: int) -> ControllerSilentError | None:
        """Ask in each cycle whether it is silent, until it is, while no frame is exchanged."""
        while self.now_ns < until_ms * MS:
            self.now_ns += 20 * MS
            if (silent := self.bus.silent(self.now_ns)) is not None:
                return silent
        return None

    def cycle(self) -> bytes | None:
        """A cycle, 20 ms later; the frame."""
        self.now_ns += 20 * MS
        frame = self.bus.begin_cycle(self.now_ns)
        if frame is not None:
            try:
                answer = self.bus.exchange(frame)
            except SpiError:
                self.bus.failed_cycle()
                raise
            self.bus.end_cycle(answer, MS, self.now_ns)
        return frame


@pytest.fixture
def parts() -> Parts:
    return Parts()


def test_it_begins_with_shutdowns_and_only_then_with_frames(parts: Parts) -> None:
    parts.bus.open()
    assert parts.said == [SHUTDOWN]
    assert [parts.cycle() for _ in range(3)] == [None] * 3
    assert angles(parts.cycle()) == {90.0}


def test_a_transfer_that_hangs_delays_no_stop_and_its_start_does_not_come(parts: Parts) -> None:
    parts.bus.open()
    parts.now_ns = 100 * MS
    parts.bus.write(starts())
    parts.cycle()
    frame = parts.bus.begin_cycle(parts.now_ns)
    assert frame is not None
    before = len(parts.said)
    assert parts.bus.put_right() is None, "the kernel would answer at the transfer's end"
    parts.bus.write(STOPS)  # while the second transfer is under way
    parts.bus.end_cycle(parts.bus.exchange(frame), 300 * MS, parts.now_ns)
    assert parts.said[before:] == [SHUTDOWN]
    assert parts.bus.put_right() == "mode 0"
    assert parts.bus.frames == 2


def test_a_failed_transfer_shuts_down_at_once_and_the_device_opens_anew(parts: Parts) -> None:
    parts.bus.open()
    parts.now_ns = 100 * MS
    parts.bus.write(starts())
    parts.spi_fails = True
    before = len(parts.said)
    with pytest.raises(SpiError, match="timed out"):
        parts.cycle()
    assert parts.said[before:] == [SHUTDOWN]
    parts.bus.release()
    assert parts.closed == 1, "the UART stays open"
    with pytest.raises(SpiError, match="no SPI"):
        parts.bus.open()
    assert parts.said[before:] == [SHUTDOWN] * 2, "each attempt begins with one"
    parts.spi_fails = False
    parts.bus.open()
    for _ in range(10):
        parts.cycle()
    assert START not in parts.said


def test_no_device_is_closed_in_the_middle_of_a_transfer(parts: Parts) -> None:
    parts.bus.open()
    assert parts.bus.begin_cycle(100 * MS) is not None
    parts.bus.release()
    assert parts.closed == 0
    with pytest.raises(SpiError, match="has not ended"):
        parts.bus.open()
    assert not parts.bus.failed_cycle(), "its failure is no news"
    assert parts.closed == 1
    parts.bus.open()
    assert parts.opened == 2


def test_a_uart_that_fails_opens_anew_and_begins_with_a_shutdown(parts: Parts) -> None:
    parts.bus.open()
    parts.uart_fails = True
    assert "hung up" in str(parts.bus.write(STOPS).fault)
    assert parts.bus.write(STOPS).fault is not None
    with pytest.raises(SpiError, match="no UART"):
        parts.bus.open()
    parts.uart_fails = False
    before = len(parts.said)
    parts.bus.open()
    assert parts.said[before:] == [SHUTDOWN]


def test_a_silent_controller_is_shut_down_and_counts_as_back_when_both_signs_are(parts: Parts) -> None:
    parts.bus.open()
    parts.beats = True
    while parts.cycle() is None:
        pass
    assert parts.bus.controller_alive is True
    parts.beats = False
    for _ in range(14):
        parts.cycle()
        assert parts.bus.silent(parts.now_ns) is None
    parts.cycle()
    before = len(parts.said)
    silent = parts.bus.silent(parts.now_ns)
    assert "no heartbeat" in str(silent)
    assert parts.said[before:] == [SHUTDOWN]
    assert parts.bus.silent(parts.now_ns) is None, "reported once"
    assert parts.bus.controller_alive is False
    parts.bus.release()
    assert parts.closed == 0, "its signs of life would come there"
    with pytest.raises(SpiError, match="no heartbeat"):
        parts.bus.open()
    parts.beats = True
    parts.cycle()
    parts.bus.open()
    assert parts.bus.controller_alive is True


def test_a_restart_is_shut_down_in_its_cycle_and_nothing_that_waited_is_started(parts: Parts) -> None:
    parts.bus.open()
    parts.beats, parts.now_ns = True, 100 * MS
    parts.cycle()
    parts.bus.write(starts())
    parts.cycle()
    before = len(parts.said)
    parts.answers = [bytes(80)]
    with pytest.raises(ControllerRestartedError, match="it goes from 00 to 00"):
        parts.cycle()  # behind which START would follow
    assert parts.said[before:] == [SHUTDOWN]
    assert parts.bus.controller_alive is False
    parts.bus.release()
    assert parts.closed == 0
    with pytest.raises(ControllerRestartedError):
        parts.bus.open()
    parts.cycle()
    parts.bus.open()
    assert parts.bus.controller_alive is True
    assert [parts.cycle() for _ in range(4)]
    assert START not in parts.said
    assert parts.bus.errors == 1, "it is counted once"


def test_without_a_device_only_stops_are_written() -> None:
    parts = Parts()
    bus = CyclicBus(None, lambda: parts)
    assert (bus.answered_ns, bus.ended_ns) == (None, 0)
    bus.open()
    assert bus.write(STOPS, preamble=True).fault is None
    assert parts.said == [SHUTDOWN] * 2
    assert "closed" in str(bus.write(starts()).fault)
    bus.close()
    assert len(SERVO_IDS) == 18


def test_when_it_left_and_how_long_it_took(parts: Parts) -> None:
    parts.bus.open()
    parts.now_ns, parts.write_takes_ns = 100 * MS, 50_000
    stops = parts.bus.write(STOPS).sent[0]
    assert (stops.ns, stops.call_ns) == (100 * MS + 50_000 + 95_486, 50_000), "ten bytes, 1 152 000 baud"
    assert parts.bus.ended_ns == 100 * MS + 50_000
    moves = parts.bus.write(starts()).sent[0]
    assert (moves.ns, moves.call_ns) == (100 * MS + 50_000, 0)
    assert [sent.data for sent in parts.bus.write(STOPS).sent] == [each.data for each in STOPS]


def test_a_uart_that_hangs_up_is_found_by_the_cycle(parts: Parts) -> None:
    parts.bus.open()
    parts.now_ns = 100 * MS
    frame = parts.bus.begin_cycle(parts.now_ns)
    assert frame is not None
    parts.hangs_up = True
    with pytest.raises(SpiError, match="disconnected"):
        parts.bus.end_cycle(parts.bus.exchange(frame), MS, parts.now_ns)
    assert parts.closed == 1
    assert parts.bus.errors == 1
    assert parts.bus.transfer_latency.max_us == 1000
    parts.hangs_up = False
    before = len(parts.said)
    parts.bus.open()
    assert parts.said[before:] == [SHUTDOWN]


def test_a_shutdown_that_cannot_be_said_opens_the_uart_anew(parts: Parts) -> None:
    parts.bus.open()
    parts.now_ns = 100 * MS
    parts.spi_fails = parts.uart_fails = True
    with pytest.raises(SpiError, match="timed out"):
        parts.cycle()
    assert parts.closed == 1
    parts.uart_fails = False
    before = len(parts.said)
    with pytest.raises(SpiError, match="timed out"):
        parts.cycle()
    assert parts.said[before:] == [], "nothing is left to say it with"


def test_an_opening_that_cannot_shut_down_fails(parts: Parts) -> None:
    parts.bus.open()
    parts.write_fails = True
    with pytest.raises(SpiError, match="hung up"):
        parts.bus.open()
    assert parts.closed == 1


def test_the_end_releases_both(parts: Parts) -> None:
    parts.bus.open()
    parts.bus.close()
    assert parts.closed == 2
    parts.bus.close()
    assert parts.closed == 2
    with pytest.raises(SpiError, match="closed"):
        parts.bus.exchange(b"")


def test_a_frame_that_the_encoder_should_not_have_made_does_not_leave(
    parts: Parts, monkeypatch: pytest.MonkeyPatch
) -> None:
    parts.bus.open()
    monkeypatch.setattr(elkapod, "frame", lambda _angles: b"\x7e" + b"\xff" * 78 + b"\x0f")
    with pytest.raises(IllegalTransferError, match="servo 11 at nan"):
        parts.bus.begin_cycle(100 * MS)


def test_other_programs_are_seen_on_the_device(parts: Parts) -> None:
    assert (parts.bus.stop_servos_at_work(), parts.bus.put_right()) == (None, None)
    parts.bus.open()
    assert (parts.bus.stop_servos_at_work(), parts.bus.put_right()) == (True, "mode 0")


def test_the_first_frame_leaves_when_its_time_has_come(parts: Parts) -> None:
    parts.bus.open()
    assert parts.bus.begin_cycle(70 * MS - 1) is None
    assert parts.bus.begin_cycle(70 * MS) is not None


def test_each_fault_is_counted_once(parts: Parts) -> None:
    counts = [parts.bus.errors]
    parts.uart_fails = True
    with pytest.raises(SpiError):
        parts.bus.open()
    counts += [parts.bus.errors]
    parts.uart_fails, parts.spi_fails = False, True
    with pytest.raises(SpiError):
        parts.bus.open()
    counts += [parts.bus.errors]
    parts.spi_fails = False
    parts.bus.open()
    parts.uart_fails = True
    parts.bus.write(STOPS)
    counts += [parts.bus.errors]
    parts.uart_fails = False
    parts.bus.open()
    parts.now_ns, parts.spi_fails = 100 * MS, True
    with pytest.raises(SpiError):
        parts.cycle()
    counts += [parts.bus.errors]
    parts.bus.release()
    parts.spi_fails = False
    parts.bus.open()
    assert parts.wait(1000) is not None
    counts += [parts.bus.errors]
    assert counts == [0, 1, 2, 3, 4, 5]


def test_a_device_that_came_back_has_its_time_to_answer(parts: Parts) -> None:
    parts.bus.open()
    parts.now_ns = 100 * MS
    parts.spi_fails = True
    with pytest.raises(SpiError):
        parts.cycle()
    parts.bus.release()
    parts.spi_fails, parts.now_ns = False, 5000 * MS
    parts.bus.open()
    assert parts.wait(5360) is None
    assert parts.bus.silent(5369 * MS) is None
    assert "(the last one: none has come)" in str(parts.bus.silent(5370 * MS))
    parts.bus.release()
    assert parts.closed == 1, "its signs of life would come there"


def test_a_device_that_fails_while_the_controller_is_silent_opens_anew(parts: Parts) -> None:
    parts.bus.open()
    assert parts.wait(400) is not None
    parts.spi_fails = True
    with pytest.raises(SpiError):
        parts.cycle()
    parts.bus.release()
    assert parts.closed == 1
    parts.spi_fails = False
    with pytest.raises(SpiError, match="no well-formed answer"):
        parts.bus.open()
    assert parts.opened == 2
