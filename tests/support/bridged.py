"""The ROS 2 bridge as a user starts it, between a gateway and a ROS router: a session in router mode, in this process.

That session is also a peer that sends what no ROS peer would.
"""

import itertools
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Final, Self

import zenoh

from gateway.geometry import joint_name, load
from gateway.model.frames import Op
from gateway.model.frames import decode as decode_frame
from gateway.people.ros2.cdr import Message, decode, encode
from gateway.people.ros2.messages import DiagnosticArray, JointState
from gateway.people.ros2.wire import PUBLISHES, QOS, Attachment, Names, gid_of
from schemas.robot import SERVO_IDS
from schemas.telemetry import Cause, FrameRecord
from tests.support.child import Child
from tests.support.fixtures import patient
from tests.support.gateway_process import COMMAND, Gateway, free_port
from tests.support.router import zenoh_listening

READY: Final = "is in ROS 2's graph"
GEOMETRY: Final = load()
RESTS_DEG: Final = {1: 90.0, 2: 150.0, 3: 110.0}
"""By joint: how the robot lies."""


class Bridge:
    """A running bridge, and the router's session."""

    def __init__(self, gateway: Gateway, endpoint: str, router: zenoh.Session, *arguments: str) -> None:
        self.endpoint = endpoint
        self.router = router
        namespace = arguments[arguments.index("--ros-namespace") + 1] if "--ros-namespace" in arguments else "/hexapod"
        self.names = Names(0, namespace, "stranger", hashes="humble" not in arguments)
        link = () if "--zenoh-config" in arguments else ("--connect", gateway.endpoint)
        self.child = Child([*COMMAND, "ros2", "--router", endpoint, *link, *arguments], clean())
        self.child.wait_for_output(READY, timeout_s=20)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """It gives the lease back, if it still runs."""
        self.child.terminate()
        self.child.wait()
        self.child.close()

    def publisher(self, topic: str, kind: type[Message], *, is_seen: bool = True) -> "RawPublisher":
        """A publisher of this process; whether the graph shows it."""
        return RawPublisher(self, topic, kind, is_seen=is_seen)

    def call(self, service: str, key: str | None = None, **options: Any) -> list[zenoh.Reply]:
        """All replies to a request without an attachment, unless one is given."""
        found: Any = self.router.get(key or f"0{self.names.full(service)}/a/b", timeout=20, **options)
        return list(found)


@contextmanager
def rejected(bridge: Bridge, why: str) -> Iterator[None]:
    """What is published meanwhile is not taken, and the diagnostics say why."""
    received = Received(bridge, "diagnostics", DiagnosticArray)
    before = _rejections(received.wait(lambda _: True))
    yield
    received.wait(
        lambda each: (
            _rejections(each) > before
            and any(why in value.value for value in each.status[-1].values if value.key == "latest_rejection")
        )
    )


def _rejections(array: DiagnosticArray) -> int:
    return sum(int(value.value) for value in array.status[-1].values if value.key.startswith("rejected "))


class RawPublisher:
    """One as rmw_zenoh has it."""

    def __init__(self, bridge: Bridge, topic: str, kind: type[Message], *, is_seen: bool) -> None:
        self._session = bridge.router
        self.key = bridge.names.topic_key(topic, kind)
        shown = bridge.names.token(
            str(self._session.zid()), 1, PUBLISHES, topic, kind.TYPE, bridge.names.shown_hash(kind.HASH), QOS
        )
        self.gid = gid_of(shown)
        self._token: Any = self._session.liveliness().declare_token(shown) if is_seen else None
        self._numbers = itertools.count(1)

    def publish(self, message: Message, *, sent_ns: int | None = None) -> None:
        """As rmw_zenoh does."""
        time_ns = time.time_ns() if sent_ns is None else sent_ns
        attachment = Attachment(next(self._numbers), time_ns, self.gid)
        self._session.put(self.key, encode(message), attachment=attachment.to_bytes())

    def put(self, payload: bytes, *, key: str | None = None, attachment: bytes | None = None) -> None:
        """As rmw_zenoh does not."""
        good = Attachment(next(self._numbers), time.time_ns(), self.gid).to_bytes()
        self._session.put(key or self.key, payload, attachment=good if attachment is None else attachment or None)

    def vanish(self) -> None:
        """Its token is gone, as when its process has died."""
        token, self._token = self._token, None
        if token is not None:
            token.undeclare()


@contextmanager
def bridged(gateway: Gateway, *arguments: str) -> Iterator[Bridge]:
    """A bridge of a gateway, with a router of its own."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with zenoh_listening(endpoint) as router, Bridge(gateway, endpoint, router, *arguments) as bridge:
        yield bridge


def clean() -> dict[str, str]:
    """This process's environment, without what ROS would have set."""
    return {name: value for name, value in os.environ.items() if not name.startswith("ROS_")}


def resting(**moved_rad: float) -> JointState:
    """All joints of a robot that lies, but those that are moved: `resting(joint_11=0.1)`, in radians from there."""
    names = tuple(map(joint_name, SERVO_IDS))
    at_rad = [
        GEOMETRY.joint_rad(servo_id, RESTS_DEG[servo_id % 10]) + moved_rad.get(name, 0.0)
        for servo_id, name in zip(SERVO_IDS, names, strict=True)
    ]
    return JointState(name=names, position=tuple(at_rad))


class Received:
    """What comes on a topic of the bridge, in this process."""

    def __init__(self, bridge: Bridge, topic: str, kind: type[Message]) -> None:
        self._kind = kind
        self._subscriber: Any = bridge.router.declare_subscriber(
            bridge.names.topic_key(topic, kind), zenoh.handlers.FifoChannel(1000)
        )

    def wait(self, condition: Callable[[Any], bool], timeout_s: float = 20.0) -> Any:
        """The next message for which it holds."""
        end_s = time.monotonic() + timeout_s
        while time.monotonic() < end_s:
            message = decode(self._kind, self._subscriber.handler.recv().payload.to_bytes())
            if condition(message):
                return message
        raise TimeoutError(f"no such {self._kind.TYPE}")


PATIENT: Final = patient(telemetry={"frames": True})
LONG_S: Final = 40.0


def keeps(publish: Callable[[], object], until: Callable[[], bool], hz: float = 50) -> None:
    """Publish at a rate until something has come of it."""
    end_s = time.monotonic() + LONG_S
    while not until():
        assert time.monotonic() < end_s, "nothing has come of it"
        publish()
        time.sleep(1 / hz)


def commanded(records: list[FrameRecord], servo_id: int) -> list[float]:
    """The angles (degrees) that were written for a servo by commands."""
    return [
        op.angle_cdeg / 100
        for record in records
        if record.cause == Cause.COMMAND
        for each, op in decode_frame(bytes.fromhex(record.bytes)).servos
        if each == servo_id and op.op is not Op.STOP
    ]
