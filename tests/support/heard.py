"""What a client hears from a gateway: kept in order, and waited for."""

import itertools
import threading
from collections import deque
from collections.abc import Callable, Iterator
from typing import Any, Generic, TypeVar

from pydantic import BaseModel

from gateway.client import Client
from gateway.model.frames import Op, decode
from schemas import keys
from schemas.event import Event, FrameRecord
from schemas.gateway_state import GatewayState
from schemas.simulation import BodyReport
from schemas.words import Cause

R = TypeVar("R", bound=BaseModel)


class Heard(Generic[R]):
    """All reports of one kind since it was made but those that are left out, or the newest `kept` of them."""

    def __init__(
        self,
        client: Client,
        key: str,
        report: type[R],
        kept: int | None = None,
        left_out: Callable[[R], bool] = lambda _: False,
    ) -> None:
        self._left_out = left_out
        self._changed = threading.Condition()
        self._reports: deque[R] = deque(maxlen=kept)
        read: Callable[[bytes], Any] = report.model_validate_json
        if report is GatewayState:
            client.state()  # also asks for the configuration: no state is left out for want of it
            read = client.states.join
        self._subscriber: Any = client.session.declare_subscriber(
            key, lambda sample: self._take(read(sample.payload.to_bytes()))
        )
        client.state()  # the gateway has answered, so it knows of the subscription, which was declared before

    def _take(self, report: R | None) -> None:
        if report is None or self._left_out(report):
            return
        with self._changed:
            self._reports.append(report)
            self._changed.notify_all()

    @property
    def all(self) -> list[R]:
        with self._changed:
            return list(self._reports)

    def each(self, *, timeout_s: float = 90) -> Iterator[R]:
        """Yield one report after the other as they come. Raises TimeoutError when none comes for `timeout_s`."""
        for count in itertools.count(1):
            yield self.wait(lambda _: True, count=count, timeout_s=timeout_s)

    def wait(self, condition: Callable[[R], bool], *, count: int = 1, timeout_s: float = 90) -> R:
        """Wait until `condition` holds for `count` reports, and return the last of these."""
        found: list[R] = []

        def enough(reports: list[R]) -> bool:
            found[:] = filter(condition, reports)
            return len(found) >= count

        self.wait_for_all(enough, timeout_s=timeout_s)
        return found[count - 1]

    def wait_for_all(self, condition: Callable[[list[R]], bool], *, timeout_s: float = 90) -> None:
        with self._changed:
            if not self._changed.wait_for(lambda: condition(list(self._reports)), timeout_s):
                raise TimeoutError(f"heard only {list(self._reports)[-20:]}")


def running(client: Client) -> list[int]:
    """Return the legs all of whose servos run."""
    return [leg.leg for leg in client.state().legs if all(servo.running for servo in leg.servos)]


def servos_on(state: GatewayState) -> set[int]:
    return {servo.id for leg in state.legs for servo in leg.servos if servo.running}


def is_stop(frame: FrameRecord) -> bool:
    return decode(bytes.fromhex(frame.bytes)).is_stop


def last_angles(records: list[FrameRecord]) -> dict[int, float]:
    """Return each servo's last angle before its Stop, in degrees, in the order of their first frames."""
    ops = (each for record in records for each in decode(bytes.fromhex(record.bytes)).servos)
    return {servo_id: op.angle_cdeg / 100 for servo_id, op in ops if op.op is not Op.STOP}


def events(client: Client) -> Heard[Event]:
    return Heard(client, keys.EVENT, Event)


def bodies(client: Client) -> Heard[BodyReport]:
    return Heard(client, keys.SIM_BODY, BodyReport)


def frames(client: Client) -> Heard[FrameRecord]:
    """Receive frames except repeated Stops and those of legs at rest: a test's duration must not change them."""
    return Heard(client, keys.FRAME, FrameRecord, left_out=lambda record: record.cause == Cause.REPEAT)


def states(client: Client, kept: int | None = None) -> Heard[GatewayState]:
    return Heard(client, keys.STATE, GatewayState, kept)
