"""The client whose calls wait for their answers."""

import json
import math
import operator
import threading
import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final, Self, TypeVar
from weakref import WeakKeyDictionary, finalize, ref

import zenoh
from pydantic import BaseModel

from gateway.errors import (
    ConfigError,
    DisconnectedError,
    LeaseLostError,
    OutOfRangeError,
    UnansweredError,
    UnreachedError,
    ZenohError,
)
from gateway.people.client import stopped
from gateway.people.client.lease import Lease
from gateway.people.client.lease_requests import Button, Identity, Requests
from gateway.people.client.payloads import (
    calibration_payload,
    leg_number,
    leg_payload,
    legs_payload,
    row,
)
from gateway.people.client.process_end import check_fork, close_at_the_end, forked, keep_signals
from gateway.people.client.question import JSON, EstopAck, Hosts, Question, close_later
from gateway.people.client.stream import Stream
from gateway.people.client.subscriptions import NO_CONFIG, States, reads
from gateway.words.own_command import command
from gateway.zenoh.config import client_config, get, one_line
from schemas import keys
from schemas.ack import Ack
from schemas.config import ConfigReport
from schemas.event import Event, FrameRecord
from schemas.gateway_state import GatewayState
from schemas.robot import LEGS
from schemas.state import StateReport, joined
from schemas.telemetry import Telemetry
from schemas.words import Kind

if TYPE_CHECKING:
    from gateway.geometry import Geometry
    from gateway.people.client.payloads import Angle, Array, Setpoints, Unit
    from gateway.people.client.walk import Walk
    from schemas.calibration import Calibration, ServoChange
    from schemas.lease import LeaseAck
    from schemas.revocation import RevocationAck

R = TypeVar("R", bound=BaseModel)
_POLL_S: Final = 0.1
_STATE_TRIES: Final = 3
"""Attempts to get a state and its configuration, which may change between the two."""


class Client:
    """A connection to one gateway. For any thread; close it, or use it in a `with`.

    >>> POSE = dict.fromkeys(range(1, 7), (90, 45, 120))        # leg → degrees of its joints 1, 2, 3
    >>> with Client(endpoint, source="an example") as robot:
    ...     robot.start_legs(POSE), robot.set_legs(POSE | {1: (90, 46, 120)}), robot.stop()
    (Ack(accepted=True), Ack(accepted=True), Ack(accepted=True))

    Starts and sets raise RejectedError (`check=False`: return the Ack), stops return their Ack. All raise
    DisconnectedError without an answer, and OutOfRangeError, a RejectedError, for a leg or angle that no robot has.
    The watchdog stops a leg after 250 ms without a command: `stream` and `walk` send in time.
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
        """Connect to the first host that answers. `source` (1 to 64 characters) is your name in events.

        `zenoh_config`: the file of your certificate, with the robot's address. `endpoint` replaces that address.
        Without either, connect to this machine's gateway. `timeout_s`: the longest wait for an answer. Raises
        ConfigError for a bad argument or file, ZenohError if no host answers: with `explain` (up to 1 s longer) a line
        for each host states what fails, and what to do.
        """
        if source is not None and not 1 <= len(source) <= keys.MAX_SOURCE:  # the gateway would reject even a Stop
            raise ConfigError(f"a source has 1 to {keys.MAX_SOURCE} characters, and this one has {len(source)}")
        if not 0 < timeout_s < math.inf:
            raise ConfigError(f"timeout_s must be positive and finite, and is {timeout_s:g} s")
        check_fork()
        file = None if zenoh_config is None else Path(zenoh_config).expanduser()
        config = client_config(endpoint, file)
        self._hosts = Hosts(config, timeout_s)
        self.robot = (str(get(config, "namespace") or ""), *self._hosts.endpoints)
        """The namespace ("" for none) and the client's endpoints. @private"""
        if not self._hosts.endpoints and get(config, "scouting/multicast/enabled") is not True:
            raise ConfigError(f"{file} names no gateway: set connect.endpoints in it, or give an endpoint")
        self._timeout_s = timeout_s
        self._source = source
        self._closed = threading.Event()
        self._answered: dict[str, Question[Any]] = {}
        keep_signals()
        try:
            self.session = self._hosts.open()
        except UnreachedError as error:
            from gateway.people.client import diagnosis  # an emergency stop must not wait for this import

            raise UnreachedError("\n".join(diagnosis.why(config) if explain else []) or str(error)) from error
        """Open until `close`: after a broken link Zenoh reconnects to any of the hosts, with all declarations."""
        self._dropped = finalize(self, dropped, self.session)
        self._dropped.atexit = False
        self._sent_by = zenoh.SourceInfo(self.session.id, 0)
        """In all messages: who sends them, also if a Stop goes by another session."""
        self.zid = str(self.session.zid())
        """The session's Zenoh id, the `source_id` of this client's commands."""
        if self._hosts.id is not None and int(self._hosts.id, 16) != int(self.zid, 16):
            why = f"the gateway does not admit the Zenoh id {self._hosts.id} of {file}"
            taken = f"another program may be connected with it, so this one has {self.zid}"
            warnings.warn(f"{why}: {taken}. Remove `id` from the file", stacklevel=2)
        self.states = States(self.session)
        """Joins states and the configuration. @private"""
        self.name = self.zid if source is None else source
        """The name in events: `source`, or the session's Zenoh id."""
        self._lease: Callable[[], Lease | None] = lambda: None
        self.open_parts: WeakKeyDictionary[Any, None] = WeakKeyDictionary()
        """Streams and walks to close before the client. @private"""
        named = endpoint or (None if file is not None else next(iter(self._hosts.endpoints), None))
        self.reset_command = command("reset", connect=named, zenoh_config=file)
        """The command that ends an emergency stop, for a person. @private"""
        close_at_the_end(self)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *raised: Any) -> None:
        if forked():
            return  # links, lease and legs are the other process's
        with ExitStack() as last:
            last.callback(self._disconnect)
            if (lease := self._lease()) is not None:
                last.callback(lease.release)
            for part in reversed(list(self.open_parts)):  # the first one ends first: a walk has a stream of its own
                last.callback(self._end, part, *(raised or (None,) * 3))

    def _end(self, part: Any, *raised: Any) -> None:
        if part in self.open_parts:
            part.__exit__(*raised)

    @property
    def requests(self) -> Requests:
        """The requests of leases and stop buttons, and of tools that renew one. @private"""
        return Requests(partial(self._get, again=False), Identity.of(self._hosts.config), self.name)

    def __repr__(self) -> str:
        return f"<Client {self.name!r} of {', '.join(self._hosts.endpoints)}{', closed' * self._closed.is_set()}>"

    def close(self) -> None:
        """End open streams and walks, release the lease, and disconnect. The program's end does the same."""
        self.__exit__()

    def _disconnect(self) -> None:
        self._closed.set()
        self._dropped.detach()
        with suppress(zenoh.ZError):  # a frozen gateway has not closed the link within ten seconds
            self.session.close()

    @property
    def connected(self) -> bool:
        """Whether there is a link now. Zenoh notices a silently dead link only after its own lease time."""
        try:
            with self._open_session() as session:
                return bool(session.info.transports())
        except ZenohError:
            return False

    def wait_ready(self, timeout_s: float = 10.0) -> GatewayState:
        """Wait until the gateway accepts commands, and return its state. Raises DisconnectedError without an answer.

        Raises StoppedError after `timeout_s`, in an emergency stop at once: who engaged it, and how to reset it.
        """
        end_s = time.monotonic() + timeout_s
        while True:
            state = self.state(max(0.01, end_s - time.monotonic()))
            if (error := stopped.unready(state, reset=self.reset_command)) is None:
                return state
            if error.cause == Kind.ESTOP_ENGAGED or time.monotonic() + _POLL_S >= end_s:
                raise error
            time.sleep(_POLL_S)

    def stream(self, hz: float = 50, *, lease: bool = True) -> Stream:
        """Return a Stream of `hz` (above 0, at most 1000) setpoints a second: `with robot.stream(50) as stream: …`.

        Streams and walks drive under the client's lease, or acquire one for their own time. `lease=False`: drive
        without, for programs that share the robot's legs.
        """
        return Stream(self, hz, lease=lease)

    def walk(
        self,
        gait: str = "tripod",
        geometry: "Geometry | Path | str | None" = None,
        hz: float = 50,
        *,
        terrain: str = "level",
    ) -> "Walk":
        """Return a Walk: `with robot.walk() as walk: walk.go(forward_m_s=0.1)`. `terrain`: `level`, `adapt` by sensors.

        `gait`: `tripod`, `ripple` or `wave`. Raises WalkError (gait, terrain), ConfigError (geometry's file).
        """
        from gateway.people.client.walk import Walk

        return Walk(self, gait, geometry, hz, terrain=terrain)

    # ---- the lease

    def lease(
        self,
        *,
        take: bool = False,
        wait_s: float = 0.0,
        source: str | None = None,
        on_lost: Callable[[LeaseLostError], None] | None = None,
        on_asked: Callable[[str], None] | None = None,
    ) -> Lease:
        """Return the right to drive for the time of a `with`: `with robot.lease(): …`; see `Lease`.

        The `with` raises LeaseError, with the `holder`, if somebody else drives. `wait_s`: ask the holder, and wait
        this many seconds for a hand-over. `take`: take the lease by force; the gateway stops all six legs first.
        `on_lost` is called (on a thread of its own) after a loss, `on_asked` with the name of a person who asks.
        A client has one lease at a time. The holder is your certificate's person, else `source`, else the client's.
        """
        return Lease(self, take=take, wait_s=wait_s, source=source, on_lost=on_lost, on_asked=on_asked)

    def ask_for_lease(self, source: str | None = None) -> "LeaseAck":
        """Ask the holder once for the lease, and return the answer. The holder may call `Lease.hand_over`."""
        return self.requests.as_person("ask", source)

    def carry(self, lease: Lease) -> None:
        """Put this lease into later commands. @private"""
        self._lease = ref(lease)

    @property
    def carried_lease(self) -> Lease | None:
        """The lease in commands; a lost one, too, until its `with` ends. @private"""
        lease = self._lease()
        return lease if lease is not None and lease.token is not None else None

    # ---- stop buttons

    def button(self, name: str | None = None) -> Button:
        """Return a stop button for the time of a `with`: `with robot.button("kitchen") as button: button.alive()`.

        The button counts as alive only while the program calls `alive`; see `Button`. Its name is your certificate's
        person, else `name`, else the client's.
        """
        return Button(self.requests, self.estop, name)

    # ---- commands, acknowledged

    def start_leg(
        self, leg: int, *angles: "Angle | Sequence[Angle] | Array", unit: "Unit" = "deg", check: bool = True
    ) -> Ack:
        """Energise leg 1 to 6 at these angles of joints 1, 2, 3, or at one list of them. `unit`: deg, rad."""
        return self._move(check, lambda: (keys.leg_command(leg_number(leg)), leg_payload("start", row(angles), unit)))

    def set_leg(
        self, leg: int, *angles: "Angle | Sequence[Angle] | Array", unit: "Unit" = "deg", check: bool = True
    ) -> Ack:
        """Move a running leg's servos to these angles, or to one list of them."""
        return self._move(check, lambda: (keys.leg_command(leg_number(leg)), leg_payload("set", row(angles), unit)))

    def start_legs(self, angles: "Setpoints", *, unit: "Unit" = "deg", check: bool = True) -> Ack:
        """Energise legs at these angles: a dict as above, or an array of all six, (6, 3) or (18,). `unit`: deg, rad."""
        return self._move(check, lambda: (keys.LEGS_COMMAND, legs_payload("start", angles, unit)))

    def set_legs(self, angles: "Setpoints", *, unit: "Unit" = "deg", check: bool = True) -> Ack:
        """Move running legs to these angles, in one message: accepted or rejected as a whole."""
        return self._move(check, lambda: (keys.LEGS_COMMAND, legs_payload("set", angles, unit)))

    def _move(self, check: bool, made: Callable[[], tuple[str, dict[str, Any]]]) -> Ack:
        try:
            ack = self.ask(*made())
        except OutOfRangeError as error:
            ack = Ack(accepted=False, reason=error.reason, detail=error.detail)
            if check:
                raise
        return ack.or_raise() if check else ack

    def stop(self, leg: int | None = None) -> Ack:
        """De-energise one leg (1 to 6), or all six (None). Return the answer, accepted or not."""
        if leg is not None:
            return self.ask(keys.leg_command(leg_number(leg)), leg_payload("stop"), again=True)
        return self.ask(keys.LEGS_COMMAND, legs_payload("stop", dict.fromkeys(LEGS, ())), again=True)

    def estop(self, source: str | None = None) -> Ack:
        """Engage the emergency stop for `source`. Return its number, the Stop frames, and the latency in µs.

        With a power board the answer has `confirmed`: if false, switch the power off by hand.
        """
        payload = self._payload(keys.ESTOP, {} if source is None else {"source": source}, None)
        return self._get(keys.ESTOP, payload, EstopAck, again=True, priority=zenoh.Priority.REAL_TIME)

    def reset(self, estop: int | None = None, *, check: bool = True) -> Ack:
        """Leave emergency stop number `estop` (None: the latest). Raises RejectedError if there is a newer one."""
        payload = {"estop": operator.index(self.state().estop if estop is None else estop)}
        return self._move(check, lambda: (keys.RESET, payload))

    # ---- calibration and revocation

    def calibration(self) -> "Calibration":
        """Return the calibration in force: trim, direction and limits of each servo, and the landing pose."""
        from schemas.calibration import Calibration  # an emergency stop must not wait for this import

        return self._get(keys.CALIBRATION, None, Calibration, again=True)

    def revocation(self, revoked: str | None = None) -> "RevocationAck":
        """Put a list of revoked certificates (PEM) in force, or return the list in force (None).

        A gateway that accepts a list stops all legs and restarts; the connection returns by itself.
        """
        from schemas.revocation import RevocationAck  # an emergency stop must not wait for this import

        payload = None if revoked is None else json.dumps({"revoked": revoked})
        return self._get(keys.REVOCATION, payload, RevocationAck, again=False)

    def calibrate(
        self,
        servos: "Mapping[int, ServoChange]" = MappingProxyType({}),
        landing: "Mapping[int, Angle | None]" = MappingProxyType({}),
        *,
        revision: int | None = None,
        accept_default: bool = False,
        check: bool = True,
    ) -> Ack:
        """Make all these changes of the calibration, or none. The answer comes once they are on the robot's disk.

        The changed servos must not run. `landing` is the landing pose in degrees; None removes a servo from it.
        With the `revision` of `calibration()`, the change is rejected if the calibration has changed since then.
        `accept_default` accepts a calibration without trims if the robot's own file cannot be read.
        """
        payload = partial(calibration_payload, servos, landing, revision=revision, accept_default=accept_default)
        return self._move(check, lambda: (keys.CALIBRATION_CMD, payload()))

    def ask(
        self, key: str, payload: Mapping[str, Any], *, again: bool = False, priority: zenoh.Priority | None = None
    ) -> Ack:
        """Send one command and return its answer. Raises DisconnectedError if no answer comes in time.

        Raises LeaseLostError if the command is rejected because its lease is lost.
        `again`: repeat an unanswered command until the client's `timeout_s` is over, also by a new session through any
        host. Only for a Stop: a repeated reset or start could undo a Stop that somebody else requested in between.
        """
        lease = None if again else self.carried_lease  # a Stop needs no lease, and a lost lease must not fail it
        data = self._payload(key, payload, lease)
        ack = self._get(key, data, Ack, again=again, priority=priority)
        if lease is not None:
            lease.judge(ack)
        return ack

    def answerers(self, key: str, wait_s: float = 0.0) -> frozenset[str]:
        """Return the Zenoh ids of the programs that replied to the latest answered question on `key`.

        Only one can be the gateway. Waits at most `wait_s` seconds for later replies. @private
        """
        if (question := self._answered.get(key)) is None:
            return frozenset()
        question.wait_for_others(wait_s)
        return frozenset(question.answerers)

    # ---- commands, fire and forget

    def publish(self, key: str, payload: Mapping[str, Any]) -> None:
        """Send one command without waiting for an answer. Only `hexapod/event` reports a rejection. @private"""
        data = self._payload(key, payload, self.carried_lease)
        with self._open_session() as session:
            session.put(key, data, encoding=JSON, express=True, source_info=self._sent_by)

    # ---- watching

    def state(self, timeout_s: float | None = None) -> GatewayState:
        """Return the current state. Raises DisconnectedError without an answer in `timeout_s` (None: the client's)."""
        for _ in range(_STATE_TRIES):
            state = self._get(keys.STATE, None, StateReport, again=True, timeout_s=timeout_s)
            known = self.states.config
            if known is None or known.config != state.config:
                try:
                    known = self._get(keys.CONFIG, None, ConfigReport, again=True, timeout_s=timeout_s)
                except UnansweredError as error:
                    raise (DisconnectedError(NO_CONFIG) if self.connected else error) from None
                self.states.config = known
            if known.config == state.config:  # else it has changed in between
                return joined(state, known)
        raise UnansweredError("the gateway's state and its configuration do not belong together; is there another one?")

    def telemetry(self, timeout_s: float | None = None) -> Telemetry | None:
        """Return the robot's newest measurements, or None if there are none. Raises as `state`."""
        try:
            return self._get(keys.TELEMETRY, None, Telemetry, again=False, timeout_s=timeout_s)
        except UnansweredError:
            self.state(timeout_s)  # raises if no gateway answers
            return None

    def on_state(self, callback: Callable[[GatewayState], None]) -> "zenoh.Subscriber[None]":
        """Call `callback` (on a Zenoh thread) for each published state, until the returned subscriber is undeclared."""
        return self._subscribe(keys.STATE, self.states.join, callback)

    def on_event(self, callback: Callable[[Event], None]) -> "zenoh.Subscriber[None]":
        """As `on_state`, for each event."""
        return self._subscribe(keys.EVENT, Event.model_validate_json, callback)

    def on_frame(self, callback: Callable[[FrameRecord], None]) -> "zenoh.Subscriber[None]":
        """As `on_state`, for each written frame, if the gateway publishes them (its `telemetry.frames`)."""
        return self._subscribe(keys.FRAME, FrameRecord.model_validate_json, callback)

    def on_telemetry(self, callback: Callable[[Telemetry], None]) -> "zenoh.Subscriber[None]":
        """As `on_state`, for the robot's measurements."""
        return self._subscribe(keys.TELEMETRY, Telemetry.model_validate_json, callback)

    def _subscribe(
        self, key: str, read: Callable[[bytes], R | None], callback: Callable[[R], None]
    ) -> "zenoh.Subscriber[None]":
        closed = self._closed  # without `self`: a subscriber keeps no client alive
        take = reads(read, lambda found: None if closed.is_set() else callback(found))
        with self._open_session() as session:
            return session.declare_subscriber(key, take)

    def check_open(self) -> None:
        """Raise ZenohError if this client is closed. @private"""
        with self._open_session():
            pass

    @contextmanager
    def _open_session(self) -> Iterator[zenoh.Session]:
        """Yield the session for one call. Raises ZenohError if it is closed or Zenoh fails."""
        check_fork()
        try:
            if not self._closed.is_set():
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
        question = Question(key, payload, answer.model_validate_json, priority, self._sent_by)
        other_ways = self._hosts if again and payload is not None else None
        with self._open_session() as session:
            found = question.ask(session, end_s, again=again, other_ways=other_ways)
        if found is not None:
            self._answered[key] = question
            return found
        waited = f"within {timeout_s:g} s" if time.monotonic() >= end_s else "and the link may have been lost"
        others = f" (the program that replies on {key} is none)" if question.answerers else ""
        raise UnansweredError(f"no gateway answered {waited}{others}{self._why_unanswered()}")

    def _why_unanswered(self) -> str:
        from gateway.people.client import diagnosis  # an emergency stop must not wait for this import

        expired = diagnosis.expired(Identity.of(self._hosts.config))
        return f": {expired}" if expired else "; is it running, and may you command it?"


def dropped(session: zenoh.Session) -> None:
    """Close the session of a client that a program has dropped: its subscribers' threads would outlast the program."""
    if not forked():
        close_later(session)
