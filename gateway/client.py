"""What a laptop's own program uses to talk to a gateway; needs neither SPI nor a compiler.

>>> from gateway.client import Client
>>> with Client(endpoint) as robot:                 # such as "tcp/192.0.2.7:7447"
...     robot.start_leg(3, 90, 45, 120).accepted    # acknowledged: the frame has been handed to SPI
...     robot.set_leg(3, 91, 45, 120).accepted      # only what runs can be set
...     robot.set_leg(4, 91, 45, 120).detail        # leg 4 was never started
...     robot.stop().accepted
True
True
'servo 41 does not run; start it before you set it'
True
"""

import json
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from queue import Empty, SimpleQueue
from types import TracebackType
from typing import Any, Final, Self, TypeVar

import zenoh
from pydantic import BaseModel

from gateway.errors import ZenohError
from gateway.zenoh_setup import client_config, open_session
from schemas import keys
from schemas.robot import JOINTS, LEGS
from schemas.telemetry import Ack, Event, GatewayState

DEFAULT_ENDPOINT: Final = "tcp/127.0.0.1:7447"
R = TypeVar("R", bound=BaseModel)


class Client:
    """A connection to one gateway.

    `ask` is acknowledged and waits for the answer; `publish` is fire and forget, for streams of setpoints. A running
    leg must hear something every 250 ms (the gateway's `watchdog.timeout_ms`), or the gateway stops it.
    """

    def __init__(
        self,
        endpoint: str | None = DEFAULT_ENDPOINT,
        *,
        zenoh_config: Path | None = None,
        source: str | None = None,
        timeout_s: float = 2.0,
    ) -> None:
        """Connect. `source` (1 to 64 characters) is who you are in the gateway's events.

        Raises ZenohError, ConfigError.
        """
        config = client_config(endpoint, zenoh_config)
        config.insert_json5("connect/timeout_ms", str(round(timeout_s * 1000)))
        self._timeout_s = timeout_s
        self._source = source
        self.session = open_session(config)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Disconnect. A leg that is left running is stopped by the gateway's watchdog."""
        self.session.close()

    # ---- commands, acknowledged

    def start_leg(self, leg: int, *angles_deg: float) -> Ack:
        """Energise a leg's three servos at these angles (degrees, 0 to 180, joints 1, 2, 3)."""
        return self.ask(keys.leg_command(leg), leg_payload("start", angles_deg))

    def set_leg(self, leg: int, *angles_deg: float) -> Ack:
        """Move a running leg's servos to these angles."""
        return self.ask(keys.leg_command(leg), leg_payload("set", angles_deg))

    def stop(self, leg: int | None = None) -> Ack:
        """De-energise one leg, or all six."""
        if leg is not None:
            return self.ask(keys.leg_command(leg), leg_payload("stop"), again=True)
        return self.ask(keys.LEGS_COMMAND, {"legs": {str(number): leg_payload("stop") for number in LEGS}}, again=True)

    def servo(self, servo_id: int, op: str, angle_deg: float | None = None) -> Ack:
        """Start, set or stop one servo (11 to 63)."""
        return self.ask(keys.servo_command(servo_id), servo_payload(op, angle_deg), again=op == "stop")

    def estop(self) -> Ack:
        """Engage the emergency stop. The answer has its number, how many Stop frames were written, and how soon."""
        return self.ask(keys.ESTOP, {}, again=True, priority=zenoh.Priority.REAL_TIME)

    def reset(self, estop: int | None = None) -> Ack:
        """Leave the emergency stop; nothing moves until it is started again.

        `estop` is the number of the emergency stop that you mean to leave (in its Ack and in the state); without it the
        gateway is first asked for the latest. If a newer one is requested meanwhile, the gateway rejects the reset.
        """
        return self.ask(keys.RESET, {"estop": self.state().estop if estop is None else estop})

    def ask(
        self, key: str, payload: Mapping[str, Any], *, again: bool = False, priority: zenoh.Priority | None = None
    ) -> Ack:
        """Send one acknowledged command. Raises ZenohError when nobody answers in time.

        `again`: where the link is lost meanwhile, or no answer comes, ask again until `timeout_s` is over. Only for
        what may safely happen twice, a Stop: a reset or a start that is asked again could undo what someone else
        stopped in between.
        """
        return Ack.model_validate_json(self._get(key, self._payload(key, payload), again=again, priority=priority))

    # ---- commands, fire and forget

    def publish(self, key: str, payload: Mapping[str, Any]) -> None:
        """Send one command without waiting; a refusal shows on `hexapod/event` only."""
        self.session.put(key, self._payload(key, payload), encoding=_JSON, express=True)

    # ---- watching

    def state(self) -> GatewayState:
        """The gateway's state now. Raises ZenohError when nobody answers in time."""
        return GatewayState.model_validate_json(self._get(keys.STATE, None, again=True))

    def on_state(self, callback: Callable[[GatewayState], None]) -> "zenoh.Subscriber[None]":
        """Call back (on a thread of Zenoh's) for each published state, until the returned subscriber is undeclared."""
        return self._subscribe(keys.STATE, GatewayState, callback)

    def on_event(self, callback: Callable[[Event], None]) -> "zenoh.Subscriber[None]":
        """Call back (on a thread of Zenoh's) for each event."""
        return self._subscribe(keys.EVENT, Event, callback)

    def _subscribe(self, key: str, report: type[R], callback: Callable[[R], None]) -> "zenoh.Subscriber[None]":
        return self.session.declare_subscriber(
            key, lambda sample: callback(report.model_validate_json(sample.payload.to_bytes()))
        )

    def _payload(self, key: str, payload: Mapping[str, Any]) -> str:
        if key == keys.ESTOP:
            return json.dumps(payload)
        named = {} if self._source is None else {"source": self._source}
        return json.dumps({"sent_ms": time.monotonic() * 1000, **named, **payload})

    def _get(self, key: str, payload: str | None, *, again: bool, priority: zenoh.Priority | None = None) -> str:
        heard: SimpleQueue[zenoh.Reply | None] = SimpleQueue()  # None: one of the attempts has ended
        end_s = time.monotonic() + self._timeout_s
        under_way = 0
        while (left_s := end_s - time.monotonic()) > 0:
            self.session.get(
                key,
                # Not `indirect`, a thread for each question that nearly doubled its time: a put never waits.
                zenoh.handlers.Callback(heard.put, lambda: heard.put(None), indirect=False),
                payload=payload,
                encoding=None if payload is None else _JSON,
                timeout=left_s,
                priority=priority,
                consolidation=zenoh.ConsolidationMode.NONE,  # else an answer waits here until its query has ended
            )
            under_way += 1
            ask_again_s = time.monotonic() + _ATTEMPT_S if again else end_s
            while under_way and (wait_s := min(ask_again_s, end_s) - time.monotonic()) > 0:
                try:
                    reply = heard.get(timeout=wait_s)
                except Empty:
                    break
                if reply is None:
                    under_way -= 1
                elif reply.ok is not None:
                    return reply.ok.payload.to_string()
            if not again:
                break
            if not under_way:  # Zenoh ends a query at once where there is no link, and where one is lost
                time.sleep(min(_AGAIN_S, max(0.0, end_s - time.monotonic())))
        waited = f"within {self._timeout_s:g} s" if time.monotonic() >= end_s else "and the link may have been lost"
        raise ZenohError(f"no gateway answered {waited}; is it running, and may you command it?")


_AGAIN_S: Final = 0.05
"""A client that lost the gateway tries to reach it again after 0.1 s (`gateway.zenoh_setup`)."""
_ATTEMPT_S: Final = 1.0
"""After so long without an answer a Stop is asked for once more: a link that is dead without a word answers nobody.

The answer to an earlier attempt counts as well: on a slow bus six Stops take longer than this.
"""
_JSON: Final = "application/json"


def leg_payload(op: str, angles_deg: tuple[float, ...] = ()) -> dict[str, Any]:
    """The payload of a leg's command: one operation for its three servos, with three angles unless it stops."""
    if op == "stop":
        return {"servos": [servo_payload(op)] * 3}
    if len(angles_deg) != len(JOINTS):
        raise ValueError(f"{len(angles_deg)} angles; a leg has three joints")
    return {"servos": [servo_payload(op, angle_deg) for angle_deg in angles_deg]}


def servo_payload(op: str, angle_deg: float | None = None) -> dict[str, Any]:
    """The payload of a servo's command."""
    return {"op": op} if angle_deg is None else {"op": op, "angle_deg": angle_deg}
