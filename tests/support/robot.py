"""A gateway without Zenoh and in virtual time: the conductor, with a simulated controller behind it.

Messages go in as the inbox would hand them over; reports and frames are kept. Time is the event loop's, which leaps
from timer to timer (async-solipsism), so a test of ten seconds takes a millisecond and nothing in it is approximate.
"""

import asyncio
import itertools
import json
import struct
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from typing import Any, TypeVar

from pydantic import BaseModel

from gateway.errors import BatchRejectedError
from gateway.model.elkapod import SHUTDOWN
from gateway.model.elkapod import START as ELKAPOD_START
from gateway.model.frames import Frame, Framing, decode
from gateway.robot.blackbox.recorder import Recorder
from gateway.robot.core.message import Messages, Received, Verb
from gateway.robot.core.supervisor import Supervisor
from gateway.robot.host.disk import StateFolder
from gateway.robot.power.line import PowerLine
from gateway.robot.runtime.calibrations import Calibrations
from gateway.robot.runtime.conductor import Conductor
from gateway.robot.runtime.request_answers import ButtonAnswers, LeaseAnswers, RequestAnswers
from gateway.robot.service import BEAT_S, rules
from gateway.robot.settings import Settings
from gateway.robot.spi import Batch, Wire
from gateway.robot.spi.bus import Bus
from gateway.robot.spi.cyclic import CYCLE_HZ, CyclicBus
from schemas import keys
from schemas.ack import Ack
from schemas.button import ButtonAck
from schemas.config import ConfigReport
from schemas.event import Event, FrameRecord
from schemas.gateway_state import GatewayState
from schemas.lease import LeaseAck
from schemas.robot import LEGS, SERVO_IDS
from schemas.state import StateReport, joined
from schemas.words import Kind
from tests.support.controllers import Elkapod, FaultyController

MS = 1_000_000
A = TypeVar("A", bound=BaseModel)
WALL_NS = 1_790_000_000_123_456_789
"""What the clock on the wall shows all the time."""


class Robot(Messages):
    """One conductor and its controller. Make it inside a running (virtual) loop."""

    start_wait_ns = 0
    """Starts without `sent_ms` leave at once, unless a test is about bursts of them; legs wait for no other, either."""

    def __init__(
        self, sections: Mapping[str, Mapping[str, Any]] | None = None, state: StateFolder | None = None
    ) -> None:
        """Make one. `sections`: settings, and as "rules" what is not a setting. `state`: keeps its calibration."""
        super().__init__()
        sections = dict(sections or {})
        changed = {"start_wait_ns": self.start_wait_ns, **sections.pop("rules", {})}
        if "start_stagger_ms" not in sections.get("limits", {}):
            changed.setdefault("start_pause_ns", 0)
        spi = sections.get("spi", {})
        shortest = {"frame_gap_us": Framing(spi.get("framing", Framing.PLAIN)).least_gap_us}  # see _pause
        merged = {**sections, "spi": {**shortest, **spi}}
        self.settings = Settings.of(merged)
        self.each_takes_ns = 0
        """How long handling one message takes."""
        self.loop = asyncio.get_running_loop()
        self._instants = 0  # a nanosecond for each message, so that no two share an instant by accident
        self.controller = FaultyController(self.settings.spi.framing, clock=self.now_ns, spend=self._pause)
        self.openings_ns: list[int] = []
        self.reports: list[tuple[str, BaseModel]] = []
        self._waiting: list[Received] = []
        self.conductor = Conductor(
            self.settings,
            Supervisor(replace(rules(self.settings), **changed)),
            self.wire(),
            self,
            self.loop,
            clock=self.now_ns,
            recorder=Recorder(self.settings, {}, self.now_ns, lambda: WALL_NS),
            line=self.power_line(),
        )
        self.conductor.reports.simulated = True
        self.conductor.messages = self
        fresh = (f"{number:032x}" for number in itertools.count(1))
        self.leases = LeaseAnswers(self.conductor, None, fresh=lambda: next(fresh))
        self.buttons = ButtonAnswers(self.conductor, None, fresh=lambda: next(fresh))
        self.calibrations = Calibrations(self.conductor, state)
        self._beat()

    def wire(self) -> Wire:
        """Return its way to the controller."""
        self.bus = Bus(self.settings.spi, self._open, clock=self.now_ns, pause=self._pause)
        return self.bus

    def take_no_lists(self) -> None:
        """Act as a kernel that rejects lists of transfers."""
        transfer = self.controller.transfer

        def one_by_one(batch: Batch) -> None:
            if len(batch) > 1:
                raise BatchRejectedError("no lists")
            transfer(batch)

        self.controller.transfer = one_by_one  # type: ignore[method-assign]

    def power_line(self) -> PowerLine | None:
        """Return its power board's line, or None without a board."""
        return None

    def _beat(self) -> None:
        """Beat as the service does."""
        self.conductor.record_alive()
        self.loop.call_later(BEAT_S, self._beat)

    def sleep_through(self, seconds: float) -> None:
        """Stop the whole process for this time, between two iterations of its event loop."""
        self._instants += round(seconds * 1e9)

    def _open(self) -> FaultyController:
        self.openings_ns.append(self.now_ns())
        return self.controller

    def _pause(self, duration_s: float) -> None:
        """Pause as the bus. Virtual time cannot pass within a call, so later events come late by as much."""
        self._instants += round(duration_s * 1e9)

    def now_ns(self) -> int:
        return round(self.loop.time() * 1e9) + self._instants

    def publish(self, key: str, report: BaseModel) -> None:
        """Take what the outbox gets."""
        self.reports.append((key, report))

    def take(self) -> Iterator[Received]:
        """Yield the inbox's side."""
        taken, self._waiting = self._waiting, []
        for received in taken:
            if received.key == keys.ESTOP:
                self.estops.append(received)
            else:
                yield received
            self._instants += self.each_takes_ns

    # ---- commands

    def put(self, key: str, payload: object = b"", **more: Any) -> None:
        self._instants += 1
        self.put_later(key, payload, **more)
        self.conductor.tick()

    def put_later(self, key: str, payload: object = b"", **more: Any) -> None:
        """Put a message that waits for the next tick."""
        data = payload if isinstance(payload, bytes) else json.dumps(payload).encode()
        fields: dict[str, Any] = {
            "key": key,
            "expression": key,
            "target": keys.COMMAND_KEYS.get(key),
            "verb": Verb.PUT,
            "payload": data,
            "size": len(data),
            "encoding": "application/json",
            "source": None,
            "received_ns": self.now_ns(),
        }
        self._waiting.append(Received(**{**fields, **more}))

    def get(self, key: str, payload: object = b"", **more: Any) -> list[Ack]:
        """Put an acknowledged command. Return the list that its answer will be in."""
        self._instants += 1
        answers = self.ask_later(key, payload, **more)
        self.conductor.tick()
        return answers

    def ask_later(self, key: str, payload: object = b"", **more: Any) -> list[Ack]:
        """Put an acknowledged command that waits for the next tick. Return the list that its answer will be in."""
        answers: list[Ack] = []
        take = answers.append
        self.put_later(key, payload, verb=Verb.GET, reply=lambda data: take(Ack.model_validate_json(data)), **more)
        return answers

    def ask(self, key: str, payload: object = b"", **more: Any) -> Ack:
        (ack,) = self.get(key, payload, **more)
        return ack

    def lease(self, do: str, source: str | None = None, **more: Any) -> LeaseAck:
        fields = {"do": do, **({} if source is None else {"source": source}), **more}
        (ack,) = self._request(self.leases, LeaseAck, fields)
        return ack

    def button(self, do: str, source: str | None = None, **more: Any) -> ButtonAck:
        fields = {"do": do, **({} if source is None else {"source": source}), **more}
        (ack,) = self._request(self.buttons, ButtonAck, fields)
        return ack

    def calibrate(self, payload: object) -> list[Ack]:
        """Request a change of the calibration. Return the list that its answer will be in."""
        return self._request(self.calibrations, Ack, payload)

    def _request(self, of: RequestAnswers, kind: type[A], payload: object) -> list[A]:
        self._instants += 1
        data = payload if isinstance(payload, bytes) else json.dumps(payload).encode()
        answers: list[A] = []
        of.read(data, self.now_ns(), lambda answer: answers.append(kind.model_validate_json(answer)))()
        return answers

    # ---- what came of it

    @property
    def frames(self) -> list[tuple[float, Frame]]:
        """Return the frames that reached the controller: when (ms), and what. With `plain` framing only."""
        return [(at_ns / MS, decode(data)) for at_ns, data in self.controller.transfers]

    def events(self, kind: Kind | None = None) -> list[Event]:
        return [
            report
            for key, report in self.reports
            if key == keys.EVENT and isinstance(report, Event) and kind in (None, report.kind)
        ]

    def state(self) -> GatewayState:
        """Return what it would publish now."""
        config = self.conductor.reports.config()
        return joined(self.conductor.reports.state(config), config)

    @property
    def states(self) -> list[GatewayState]:
        now = self.conductor.reports.config()
        configs = {now.config: now}
        configs |= {each.config: each for _, each in self.reports if isinstance(each, ConfigReport)}
        states = (report for _, report in self.reports if isinstance(report, StateReport))
        return [joined(state, configs[state.config]) for state in states]

    @property
    def records(self) -> list[FrameRecord]:
        return [report for key, report in self.reports if key == keys.FRAME and isinstance(report, FrameRecord)]

    @property
    def mode(self) -> str:
        return self.conductor.supervisor.mode


def started(**sections: Mapping[str, Any]) -> Robot:
    """Return a robot whose gateway takes commands; its start's frames and their repeats are forgotten."""
    robot = Robot(sections)
    robot.conductor.start()
    robot.conductor.reports.announce_start()
    return robot


async def started_and_quiet(**sections: Mapping[str, Any]) -> Robot:
    """Return a started robot after the Stops at the start and all that follow them, with nothing recorded yet."""
    robot = started(**sections)
    await asyncio.sleep(6)
    robot.controller.transfers.clear()
    robot.reports.clear()
    return robot


def leg(op: str, *angles_deg: float, **more: Any) -> dict[str, Any]:
    servos = [{"op": op, "angle_deg": angle_deg} for angle_deg in angles_deg] or [{"op": op}] * 3
    return {"servos": servos, **more}


LEG_1, LEG_3 = keys.leg_command(1), keys.leg_command(3)
START = leg("start", 90, 90, 90)


def servo(op: str, angle_deg: float | None = None, **more: Any) -> dict[str, Any]:
    return {"op": op, **({} if angle_deg is None else {"angle_deg": angle_deg}), **more}


# ---- a robot of elkapod-2025


class ElkapodRobot(Robot):
    """A robot of elkapod-2025 whose gateway has begun; frames go from then on."""

    def __init__(self, sections: Mapping[str, Mapping[str, Any]] | None = None) -> None:
        sections = sections or {}
        super().__init__({**sections, "wire": {"name": "elkapod-2025"}})
        self.conductor.start()
        self.conductor.reports.announce_start()
        self.loop.call_later(1 / CYCLE_HZ, self._go_on)

    def wire(self) -> Wire:
        self.elkapod = Elkapod(clock=self.now_ns)
        self.cyclic = CyclicBus(
            lambda: self.elkapod,
            lambda: self.elkapod,
            fed_singly=bool(self.settings.power.interface),
            clock=self.now_ns,
        )
        return self.cyclic

    def _go_on(self) -> None:
        self.cyclic.cycle(self.conductor.owner, self.conductor.measured, self.conductor.bus_failed)
        self.loop.call_later(1 / CYCLE_HZ, self._go_on)

    @property
    def said(self) -> list[tuple[float, str]]:
        """Return the UART's messages: when (ms), and what."""
        names = {ELKAPOD_START: "start", SHUTDOWN: "shutdown"}
        return [(at_ns / MS, names[message]) for at_ns, message in self.elkapod.messages]

    def kinds(self) -> list[Kind]:
        return [Kind(event.kind) for event in self.events()]


def angles_of(frame: bytes) -> dict[int, float]:
    assert (len(frame), frame[0], frame[-1]) == (80, 0x7E, 0x0F)
    return dict(zip(SERVO_IDS, struct.unpack_from("<18f", frame, 1), strict=True))


def all_legs(op: str, angle_deg: float | None = None, legs: Iterable[int] = LEGS) -> dict[str, Any]:
    angles_deg = () if angle_deg is None else (angle_deg,) * 3
    return {"legs": {str(number): leg(op, *angles_deg) for number in legs}}


async def elkapod(**sections: Mapping[str, Any]) -> ElkapodRobot:
    """Return one that has been up until nothing follows its first Stops, with nothing recorded yet."""
    robot = ElkapodRobot(sections)
    await asyncio.sleep(6)
    robot.elkapod.messages.clear()
    robot.elkapod.transfers.clear()
    robot.reports.clear()
    return robot
