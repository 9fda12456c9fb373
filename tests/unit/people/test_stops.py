"""A terminal's Stop on real threads: each finds one, and what became of a request is noted in order."""

from queue import SimpleQueue

from gateway.errors import DisconnectedError
from gateway.people.client.confirmed_stop import UntilConfirmed
from schemas.telemetry import Ack

STOPPED = Ack(accepted=True, stop_frames=6, latency_us=800.0)
LATE_S = 10


class Gateway:
    """Answers when the test says so; each request is of another thread."""

    def __init__(self) -> None:
        self.wanted = True
        self.requests: SimpleQueue[SimpleQueue[Ack | Exception]] = SimpleQueue()
        self.noted: SimpleQueue[Ack | Exception] = SimpleQueue()
        self.stops = UntilConfirmed(self._estop, self._note)

    def asked(self) -> "SimpleQueue[Ack | Exception]":
        return self.requests.get(timeout=LATE_S)

    def pressed(self) -> "SimpleQueue[Ack | Exception]":
        self.stops.press()
        return self.asked()

    def _estop(self) -> Ack:
        answer: SimpleQueue[Ack | Exception] = SimpleQueue()
        self.requests.put(answer)
        outcome = answer.get()
        if isinstance(outcome, Exception):
            raise outcome
        return outcome

    def _note(self, outcome: Ack | Exception) -> bool:
        self.noted.put(outcome)
        if isinstance(outcome, MemoryError):
            raise outcome
        return self.wanted


def test_it_is_requested_again_until_it_is_confirmed_whatever_goes_wrong() -> None:
    gateway = Gateway()
    gateway.stops.press()
    faults: list[Ack | Exception] = [
        MemoryError(),
        RuntimeError("can't start new thread"),
        DisconnectedError("no answer"),
    ] * 2
    for outcome in (*faults, STOPPED):
        gateway.asked().put(outcome)
        assert gateway.noted.get(timeout=LATE_S) is outcome
    assert gateway.stops.since_ns is None


def test_what_nobody_wants_any_more_is_not_requested_again_and_the_next_press_is() -> None:
    gateway = Gateway()
    gateway.wanted = False
    gateway.pressed().put(DisconnectedError("no answer"))
    assert isinstance(gateway.noted.get(timeout=LATE_S), DisconnectedError)
    earlier, later = gateway.pressed(), gateway.pressed()
    earlier.put(DisconnectedError("no answer"))
    assert isinstance(gateway.noted.get(timeout=LATE_S), DisconnectedError)
    later.put(STOPPED)
    assert gateway.noted.get(timeout=LATE_S) is STOPPED, "it was pressed after what nobody wants"
    first = gateway.pressed()
    gateway.stops.take_back()
    assert gateway.stops.since_ns is None
    second = gateway.pressed()
    first.put(DisconnectedError("from before the reset"))
    second.put(STOPPED)
    assert gateway.noted.get(timeout=LATE_S) is STOPPED
