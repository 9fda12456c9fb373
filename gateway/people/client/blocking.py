"""A connection to one gateway whose calls wait for their answers."""

import json
import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal, Self, TypeVar

import zenoh
from pydantic import BaseModel, Field

from gateway.errors import ConfigError, LeaseLostError, StoppedError, UnansweredError, UnreachedError, ZenohError
from gateway.people.client.button import Button
from gateway.people.client.close_at_exit import close_at_the_end
from gateway.people.client.hosts import Hosts
from gateway.people.client.lease import Lease
from gateway.people.client.payloads import (
    Angle,
    calibration_payload,
    leg_number,
    leg_payload,
    legs_payload,
    row,
    servo_number,
    servo_payload,
)
from gateway.people.client.question import JSON, Question
from gateway.people.client.requests import ButtonRequests, Identity, LeaseRequests
from gateway.people.client.stream import Stream
from gateway.people.client.subscriptions import reports
from gateway.zenoh_config import client_config, get, one_line
from schemas import keys
from schemas.robot import LEGS
from schemas.telemetry import Ack, Event, GatewayState, Mode

if TYPE_CHECKING:
    from gateway.geometry import Geometry
    from gateway.people.client.walk import Walk
    from schemas.calibration import Calibration, ServoChange
    from schemas.lease import LeaseAck
    from schemas.revocation import RevocationAck

R = TypeVar("R", bound=BaseModel)
_POLL_S: Final = 0.1


class Client:
    """A connection to one gateway. For any thread; close it, or use it in a `with`.

    Commands are acknowledged: the Ack states whether the frame has been written, or why not. A running leg must be sent
    something every 250 ms (the gateway's `watchdog.timeout_ms`), or the gateway stops it; `stream` is for that. All
    raise DisconnectedError when no gateway answers in time, ValueError for a leg or servo that does not exist or a
    wrong count of angles, TypeError for a leg, servo or angle that is no number.

    >>> with Client(endpoint, source="an example") as robot:
    ...     robot.wait_ready().mode
    ...     robot.start_legs({1: (90, 45, 120), 4: (90, 45, 120)}).accepted
    ...     robot.set_legs({1: (90, 46, 120), 5: (90, 46, 120)}).detail
    ...     robot.stop().accepted
    <Mode.IDLE: 'idle'>
    True
    'servo 51 does not run; start it before you set it'
    True
    """

    def __init__(
        self,
        endpoint: str | None = None,
        *,
        zenoh_config: str | Path | None = None,
        source: str | None = None,
        timeout_s: float = 2.0,
        explain: bool = True,
    ) -> None:
        """Connect, by whichever host of the file answers first. `source` (1 to 64 characters) is who you are in events.

        `zenoh_config` is the file that came with your certificate, and states where the robot is. An `endpoint` that is
        given goes before the file's; with neither, it is this machine's gateway. `timeout_s`: how long an answer may
        take. Raises ConfigError, and ZenohError, which with `explain` has a line for each host: the step that fails,
        and what to do. To find that out takes up to a second more.
        """
        if source is not None and not 1 <= len(source) <= keys.MAX_SOURCE:  # also a Stop would be rejected for it
            raise ConfigError(f"a source has 1 to {keys.MAX_SOURCE} characters, and this one has {len(source)}")
        if not 0 < timeout_s < math.inf:
            raise ConfigError(f"a timeout of {timeout_s:g} s will not do; it is a time above 0")
        file = None if zenoh_config is None else Path(zenoh_config).expanduser()
        config = client_config(endpoint, file)
        self._hosts = Hosts(config, timeout_s)
        self.robot = (str(get(config, "namespace") or ""), *self._hosts.endpoints)
        """What is dialled: the namespace ("" for none), and the endpoints. @private"""
        if not self._hosts.endpoints and get(config, "scouting/multicast/enabled") is not True:
            raise ConfigError(f"{file} names no gateway: set connect.endpoints in it, or give an endpoint")
        self._timeout_s = timeout_s
        self._source = source
        self._closed = False
        self._answered: dict[str, Question[Any]] = {}
        try:
            self.session = self._hosts.open()
        except UnreachedError as error:
            raise UnreachedError((_why(config) if explain else "") or str(error)) from error
        """Lives until `close`: when its link breaks, it comes back by any of the hosts, with all that is declared."""
        self.name = str(self.session.info.zid()) if source is None else source
        """Who this is in events: `source`, or the session's Zenoh id (which only a stream's commands tell)."""
        self.lease_requests = LeaseRequests(partial(self._get, again=False), Identity.of(config), self.name)
        """For the lease, and for tools that keep one. @private"""
        self.button_requests = ButtonRequests(partial(self._get, again=False), Identity.of(config), self.name)
        """For a button, and for tools that are one. @private"""
        self._lease: Lease | None = None
        self.walks = False
        """Whether a walk of it is open; two would move the same legs. @private"""
        close_at_the_end(self)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Disconnect. A leg that is left running is stopped by the gateway's watchdog, and a lease is released.

        A program that forgets it ends all the same.
        """
        if self._lease is not None:
            self._lease.release()
        self._closed = True
        with suppress(zenoh.ZError):  # a frozen gateway did not say good-bye within ten seconds
            self.session.close()

    @property
    def connected(self) -> bool:
        """Whether there is a link now. Zenoh notices one that died without a word only after its lease."""
        try:
            with self._open_session() as session:
                return bool(session.info.transports())
        except ZenohError:
            return False

    def wait_ready(self, timeout_s: float = 10.0) -> GatewayState:
        """Wait until the gateway takes commands; its state then.

        Raises DisconnectedError when nobody answers until then, StoppedError when it does and takes none (an emergency
        stop, a bus fault).
        """
        end_s = time.monotonic() + timeout_s
        while True:
            state = self.state(max(0.01, end_s - time.monotonic()))
            if state.mode in (Mode.IDLE, Mode.ACTIVE):
                return state
            if time.monotonic() + _POLL_S >= end_s:
                raise StoppedError(f"the gateway takes no commands after {timeout_s:g} s: its mode is {state.mode}", ())
            time.sleep(_POLL_S)

    def stream(self, hz: float = 50) -> Stream:
        """Setpoints of a gait, `hz` (above 0, at most 1000) times a second: `with robot.stream(50) as stream: …`.

        Of more than the gateway's `limits.leg_rate_hz` it leaves some out; the stream then warns.
        """
        return Stream(self, hz)

    def walk(self, gait: str = "tripod", geometry: "Geometry | Path | str | None" = None, hz: float = 50) -> "Walk":
        """Velocities in place of angles: `with robot.walk() as walk: walk.go(forward_m_s=0.1)`; see `Walk`.

        `gait`: tripod, ripple or wave. `geometry`: of another robot than the Elkapod. Raises WalkError, ConfigError.
        """
        from gateway.people.client.walk import Walk

        return Walk(self, gait, geometry, hz)

    # ---- who is driving

    def lease(
        self,
        *,
        take: bool = False,
        wait_s: float = 0.0,
        source: str | None = None,
        on_lost: Callable[[LeaseLostError], None] | None = None,
        on_asked: Callable[[str], None] | None = None,
    ) -> Lease:
        """The right to drive, for the time of a `with`: `with robot.lease(): …`; see `Lease`.

        While somebody else drives, it raises LeaseError with the `holder`. With `wait_s` it asks the holder, and waits
        that long to be handed it. With `take` it takes it by force: the gateway stops all six legs first.
        `on_lost` is called (on a thread of its own) once it is lost, `on_asked` with the name of whoever asks for it.
        A client has one lease at a time. With a certificate you are its person; without, `source`, or the client's.
        """
        return Lease(self, take=take, wait_s=wait_s, source=source, on_lost=on_lost, on_asked=on_asked)

    def ask_for_lease(self, source: str | None = None) -> "LeaseAck":
        """Tell the holder that you would like to drive, once; `Lease.hand_over` is the holder's answer."""
        return self.lease_requests.as_person("ask", source)

    def carry(self, lease: Lease) -> None:
        """From now on commands carry this lease. @private"""
        self._lease = lease

    @property
    def carried_lease(self) -> Lease | None:
        """The lease that commands carry; also one that was lost, until its `with` ends. @private"""
        return self._lease if self._lease is not None and self._lease.token is not None else None

    # ---- who watches

    def button(self, name: str | None = None) -> Button:
        """A stop button, for the time of a `with`: `with robot.button("kitchen") as button: button.alive()`.

        It is alive only as often as the program says so; see `Button`. With a certificate you are its person; without,
        `name`, or the client's.
        """
        return Button(self.button_requests, self.estop, name)

    # ---- commands, acknowledged

    def start_leg(self, leg: int, *angles_deg: Angle | Sequence[Angle]) -> Ack:
        """Energise a leg's three servos at these angles (degrees, 0 to 180, joints 1, 2, 3), or at one list of them."""
        return self.ask(keys.leg_command(leg_number(leg)), leg_payload("start", row(angles_deg)))

    def set_leg(self, leg: int, *angles_deg: Angle | Sequence[Angle]) -> Ack:
        """Move a running leg's servos to these angles, or to one list of them."""
        return self.ask(keys.leg_command(leg_number(leg)), leg_payload("set", row(angles_deg)))

    def start_legs(self, angles_deg: Mapping[int, Sequence[Angle]]) -> Ack:
        """Energise several legs (1 to 6) at these angles, in one message: checked as a whole."""
        return self.ask(keys.LEGS_COMMAND, legs_payload("start", angles_deg))

    def set_legs(self, angles_deg: Mapping[int, Sequence[Angle]]) -> Ack:
        """Move several running legs to these angles, in one message: checked as a whole."""
        return self.ask(keys.LEGS_COMMAND, legs_payload("set", angles_deg))

    def stop(self, leg: int | None = None) -> Ack:
        """De-energise one leg, or all six."""
        if leg is not None:
            return self.ask(keys.leg_command(leg_number(leg)), leg_payload("stop"), again=True)
        return self.ask(keys.LEGS_COMMAND, legs_payload("stop", dict.fromkeys(LEGS, ())), again=True)

    def servo(self, servo_id: int, op: str, angle_deg: Angle | None = None) -> Ack:
        """Start, set or stop one servo (11 to 63)."""
        key = keys.servo_command(servo_number(servo_id))
        return self.ask(key, servo_payload(op, angle_deg), again=op == "stop")

    def estop(self, source: str | None = None) -> Ack:
        """Engage the emergency stop. The answer has its number, how many Stop frames were written, and how soon.

        `source`: who requests it, if not this client by its own name.
        """
        payload = self._payload(keys.ESTOP, {} if source is None else {"source": source}, None)
        return self._get(keys.ESTOP, payload, _EstopAck, again=True, priority=zenoh.Priority.REAL_TIME)

    def reset(self, estop: int | None = None) -> Ack:
        """Leave the emergency stop; nothing moves until it is started again.

        `estop` is the number of the emergency stop that you mean to leave (in its Ack and in the state); without it the
        gateway is first asked for the latest. If a newer one is requested meanwhile, the gateway rejects the reset.
        """
        return self.ask(keys.RESET, {"estop": self.state().estop if estop is None else estop})

    # ---- how the robot was built

    def calibration(self) -> "Calibration":
        """Trim, direction and limits of each servo, and the landing pose, as they are in force."""
        from schemas.calibration import Calibration  # no emergency stop waits for what it loads

        return self._get(keys.CALIBRATION, None, Calibration, again=True)

    def revocation(self, revoked: str | None = None) -> "RevocationAck":
        """Put a list of revoked certificates in force (PEM), or ask which one is.

        A gateway that takes it stops all legs and starts anew; the connection comes back by itself.
        """
        from schemas.revocation import RevocationAck  # no emergency stop waits for what it loads

        payload = None if revoked is None else json.dumps({"revoked": revoked})
        return self._get(keys.REVOCATION, payload, RevocationAck, again=False)

    def calibrate(
        self,
        servos: "Mapping[int, ServoChange]" = MappingProxyType({}),
        landing: Mapping[int, Angle | None] = MappingProxyType({}),
        *,
        revision: int | None = None,
        accept_default: bool = False,
    ) -> Ack:
        """Change the calibration: all that is named, or nothing. Accepted once it is kept on the robot's disk.

        No servo that it changes may run. `landing` is the landing pose in degrees; None takes a servo out of it. With
        `revision`, that of `calibration()`, it is rejected if somebody else has changed it meanwhile. `accept_default`
        takes the calibration without any trim as this robot's, where the file that kept its own cannot be read.
        """
        return self.ask(
            keys.CALIBRATION_CMD,
            calibration_payload(servos, landing, revision=revision, accept_default=accept_default),
        )

    def ask(
        self, key: str, payload: Mapping[str, Any], *, again: bool = False, priority: zenoh.Priority | None = None
    ) -> Ack:
        """Send one acknowledged command. Raises DisconnectedError when nobody answers in time.

        Raises LeaseLostError when it was rejected because the lease that it carries has been lost.

        `again`: where the link is lost meanwhile, or no answer comes, ask again until `timeout_s` is over, also by a
        session of its own through whichever host answers. Only for what may safely happen twice, a Stop: a reset or a
        start that is asked again could undo what someone else stopped in between.
        """
        lease = None if again else self.carried_lease  # a Stop needs none, and must not fail by one
        data = self._payload(key, payload, lease)
        ack = self._get(key, data, Ack, again=again, priority=priority)
        if lease is not None:
            lease.judge(ack)
        return ack

    def answerers(self, key: str, wait_s: float = 0.0) -> frozenset[str]:
        """Zenoh ids of the programs that replied to the latest question on `key` that got its answer.

        Only one can be the gateway. Those that reply later than it are waited for, at most so long.
        """
        question = self._answered.get(key)
        if question is None:
            return frozenset()
        question.wait_for_others(wait_s)
        return frozenset(question.answerers)

    # ---- commands, fire and forget

    def publish(self, key: str, payload: Mapping[str, Any]) -> None:
        """Send one command without waiting; a rejection shows on `hexapod/event` only."""
        data = self._payload(key, payload, self.carried_lease)
        with self._open_session() as session:
            session.put(key, data, encoding=JSON, express=True)

    # ---- watching

    def state(self, timeout_s: float | None = None) -> GatewayState:
        """The gateway's state now. Raises DisconnectedError when nobody answers in time (None: the client's own)."""
        return self._get(keys.STATE, None, GatewayState, again=True, timeout_s=timeout_s)

    def on_state(self, callback: Callable[[GatewayState], None]) -> "zenoh.Subscriber[None]":
        """Call back (on a thread of Zenoh's) for each published state, until the returned subscriber is undeclared."""
        return self._subscribe(keys.STATE, GatewayState, callback)

    def on_event(self, callback: Callable[[Event], None]) -> "zenoh.Subscriber[None]":
        """Call back (on a thread of Zenoh's) for each event."""
        return self._subscribe(keys.EVENT, Event, callback)

    def _subscribe(self, key: str, report: type[R], callback: Callable[[R], None]) -> "zenoh.Subscriber[None]":
        take = reports(report, lambda found: None if self._closed else callback(found))
        with self._open_session() as session:
            return session.declare_subscriber(key, take)

    def check_open(self) -> None:
        """Raise what each call raises once this client is closed: ZenohError. @private"""
        with self._open_session():
            pass

    @contextmanager
    def _open_session(self) -> Iterator[zenoh.Session]:
        """The session, for one call. Raises ZenohError, one sentence, once it is closed."""
        try:
            if not self._closed:
                yield self.session
                return
        except zenoh.ZError as error:
            if not self.session.is_closed():
                raise ZenohError(f"Zenoh cannot do that: {one_line(error)}") from error
        raise ZenohError("this client is closed; make a new one")

    def _payload(self, key: str, payload: Mapping[str, Any], lease: Lease | None) -> str:
        named = {} if self._source is None else {"source": self._source}
        if key == keys.ESTOP:
            return json.dumps({**named, **payload})
        if lease is not None and (token := lease.token) is not None:
            named["lease"] = token
        return json.dumps({"sent_ms": time.monotonic() * 1000, **named, **payload})

    def _get(
        self,
        key: str,
        payload: str | None,
        answer: type[R],
        *,
        again: bool,
        priority: zenoh.Priority | None = None,
        timeout_s: float | None = None,
    ) -> R:
        timeout_s = timeout_s or self._timeout_s
        end_s = time.monotonic() + timeout_s
        question = Question(key, payload, answer.model_validate_json, priority)
        other_ways = self._hosts if again and payload is not None else None
        with self._open_session() as session:
            found = question.ask(session, end_s, again=again, other_ways=other_ways)
        if found is not None:
            self._answered[key] = question
            return found
        waited = f"within {timeout_s:g} s" if time.monotonic() >= end_s else "and the link may have been lost"
        others = f" (what answers on {key} is none)" if question.answerers else ""
        raise UnansweredError(f"no gateway answered {waited}{others}; is it running, and may you command it?")


def _why(config: zenoh.Config) -> str:
    from gateway.people.client import diagnosis  # only now: no emergency stop waits for what it loads

    return "\n".join(diagnosis.why(config))


class _EstopAck(Ack):
    """Without these it is not the gateway's: an emergency stop is always taken."""

    accepted: Literal[True]
    stop_frames: Annotated[int, Field(ge=0)]
    latency_us: Annotated[float, Field(ge=0, allow_inf_nan=False)]


def several_answer(count: int, key: str) -> str:
    """What to tell a person where `Client.answerers` has found more than one."""
    return (
        f"{count} programs answer on {key}, and only one of them is the gateway; "
        "certificates keep others out (docs/security.md)"
    )
