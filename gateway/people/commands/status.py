"""`hexapod-gateway status`: one look at the state, or with `--follow` a line for each change, until a signal."""

import json
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from datetime import datetime
from functools import partial
from typing import Final, NamedTuple, NoReturn

from gateway import certs
from gateway.allowance import NS_PER_S
from gateway.people.client import diagnosis
from gateway.people.client.blocking import Client, several_answer
from gateway.people.client.dangers import PowerAlarm, power_now
from gateway.people.client.live import Live, Order, Receiver, Starts
from gateway.people.commands import why
from gateway.people.commands.options import Reach
from gateway.people.terminal import hint, on_end_signals, say
from gateway.people.walking.words import robot_now
from gateway.text import visible
from gateway.zenoh_config import client_config
from schemas import keys
from schemas.telemetry import Event, GatewayState, LegReport


def status(reach: Reach, *, as_json: bool) -> None:
    """Print the state, as sentences or JSON. Raises ZenohError if no gateway answers."""
    with reach.connection("status")() as client:
        state = client.state()
    if as_json:
        sys.stdout.write(f"{state.model_dump_json()}\n")
        return
    for sentence in sentences(state):
        say(sentence)


def topics(state: GatewayState) -> dict[str, str]:
    """Return what a person asks of a moving robot, a sentence for each topic; "": nothing to report."""
    lease, buttons, certificate = state.lease, state.buttons, state.certificate
    drives = "drives" if lease.held_s is not None else "is handed the lease"
    soon = None if certificate is None else certs.expires_soon(certificate.file, certificate.expires, state.time)
    missing = ", ".join(state.missing_endpoints)
    watched = f"Stop buttons: {buttons.alive} alive, {buttons.required} required."
    return {
        "robot": f"{robot_now(state)}.",
        "lease": "Nobody drives." if lease.holder is None else f"{lease.holder} {drives}.",
        "buttons": watched if buttons.required or buttons.alive else "",
        "calibration": "" if state.calibration.fault is None else f"Nothing can be started: {state.calibration.fault}",
        "controller": _controller(state),
        "power": "" if state.power is None else f"Power ({state.power.interface}): {power_now(state.power)}.",
        "address": f"Does not listen on {missing} yet: the address is not there." if missing else "",
        "certificate": "" if soon is None else f"The robot's {soon}; {certs.renewal('gateway')}",
    }


def sentences(state: GatewayState) -> list[str]:
    """Return what a person asks first, a line each: may it move, what runs, who drives, what is wrong."""
    asked, spi, watchdog, battery = topics(state), state.spi, state.watchdog, state.battery
    found = [f"{asked['robot']} Gateway {state.version}, up {state.uptime_s:.0f} s."]
    found += (_leg(leg) for leg in state.legs if any(servo.running for servo in leg.servos))
    found += (asked["lease"], asked["buttons"], asked["calibration"])
    device = "a simulated controller" if state.simulated else spi.device
    spoken = state.protocol if spi.framing == "none" else spi.framing
    found.append(f"{spi.frames} frames to {device} ({spoken}), {spi.errors} SPI errors.")
    found.append(_controller(state, state.controller.age_ms))
    if battery is not None:
        found.append(f"Battery: {battery.voltage_v:.2f} V, {battery.percent:.0f} %.")
    alarm = PowerAlarm()
    alarm.received_state(state, 0)
    found.append(f"{asked['power']} {alarm.sentence}".strip())
    found.append(
        f"{state.commands.accepted} commands accepted, {state.commands.rejected} rejected; "
        f"the watchdog ({watchdog.timeout_ms:g} ms) has stopped {watchdog.expirations} legs."
    )
    found += (asked["address"], asked["certificate"])
    if state.incident is not None:
        found.append(f"Latest incident: {state.incident} (hexapod-gateway incidents show {state.incident}).")
    return [each for each in found if each]


def _controller(state: GatewayState, age_ms: float | None = None) -> str:
    controller = state.controller
    if controller.alive is None:
        return ""
    silence = "" if age_ms is None else f", its last answer {age_ms / 1000:.1f} s ago"
    return f"The controller ({state.wire.name}) {'is alive' if controller.alive else f'is SILENT{silence}'}."


def _leg(leg: LegReport) -> str:
    angles = ", ".join(f"{servo.angle_deg:g}°" if servo.running else "off" for servo in leg.servos)
    by = "" if leg.source is None else f", by {leg.source}"
    return f"Leg {leg.leg} runs at {angles}{by}."


# ---- what follows after one look

SILENT_AFTER_NS: Final = 2 * NS_PER_S
"""Time for a question to a gateway that publishes no state, and for one lost answer (live.py: 0.4 s, 0.6 s, 0.4 s).
The liveliness token shows the end of its process at once."""
_POLL_S: Final = 0.1
_OTHERS_S: Final = 0.2
"""How long to wait for replies of other programs than the gateway."""


class NewsLine(NamedTuple):
    """One thing that happened."""

    time: datetime
    kind: str
    text: str
    as_json: str

    @property
    def plain(self) -> str:
        """Return the line for people, with the local time."""
        return f"{self.time.astimezone():%H:%M:%S} {visible(self.kind):18} {visible(self.text)}"


class StatusChanges:
    """The changes in states and events. Pure: `now_ns` is monotonic, `wall` is for people."""

    def __init__(self) -> None:
        self._known: dict[str, str] = {}
        self._alarm = PowerAlarm()
        self._starts = Starts()
        self._received_ns: int | None = None
        self._silent = False
        self._said: set[str] = set()
        """Sentences that were printed since the gateway fell silent."""

    def received_state(self, state: GatewayState, now_ns: int, wall: datetime) -> Iterator[NewsLine]:
        """Yield a line for each sentence that differs from the state before."""
        yield from self._received(now_ns, wall)
        order = self._starts.judge(state.time, state.uptime_s, now_ns)
        if order is Order.OVERTAKEN:
            return
        if order is Order.RESTARTED:
            yield change(wall, "gateway", "The gateway was started again.")
        self._alarm.received_state(state, now_ns)
        yield from self._changed({**topics(state), "alarm": self._alarm.sentence}, wall)

    def received_event(self, event: Event, now_ns: int, wall: datetime) -> Iterator[NewsLine]:
        """Yield the event's line."""
        yield from self._received(now_ns, wall)
        who = [event.source] if event.source is not None and event.source not in event.detail else []
        text = ": ".join([*who, *([str(event.reason)] if event.reason is not None else []), event.detail])
        text += f" (and {event.left_out} more that are left out)" if event.left_out else ""
        yield NewsLine(event.time, str(event.kind), text, event.model_dump_json())
        self._alarm.received_event(event.kind)
        yield from self._changed({"alarm": self._alarm.sentence}, wall)

    def received_token(self, alive: bool, now_ns: int, wall: datetime) -> Iterator[NewsLine]:
        """Take an appearance (`alive`) or a loss of the gateway's liveliness token."""
        yield from self._received(now_ns, wall) if alive else self._is_silent(wall)

    def poll(self, now_ns: int, wall: datetime) -> Iterator[NewsLine]:
        """Yield a line if the gateway has fallen silent. Call several times a second."""
        if self._received_ns is not None and now_ns - self._received_ns > SILENT_AFTER_NS:
            yield from self._is_silent(wall)

    def note(self, text: str, wall: datetime) -> Iterator[NewsLine]:
        """Yield a sentence about the connection, once until something is received again."""
        if text not in self._said:
            self._said.add(text)
            yield change(wall, "gateway", text)

    @property
    def receives(self) -> bool:
        """Whether the gateway publishes, as far as is known."""
        return self._received_ns is not None and not self._silent

    def _changed(self, sentences: dict[str, str], wall: datetime) -> Iterator[NewsLine]:
        for what, sentence in sentences.items():
            before, self._known[what] = self._known.get(what, ""), sentence
            if sentence not in ("", before):
                yield change(wall, what, sentence)

    def _received(self, now_ns: int, wall: datetime) -> Iterator[NewsLine]:
        if self._silent and self._received_ns is not None:
            away_s = (now_ns - self._received_ns) / NS_PER_S
            yield change(wall, "gateway", f"The gateway publishes again, after {away_s:.1f} s.")
        if not self.receives:
            self._said.clear()
        self._received_ns, self._silent = now_ns, False

    def _is_silent(self, wall: datetime) -> Iterator[NewsLine]:
        if self.receives:
            self._silent = True
            yield change(wall, "gateway", "The gateway is SILENT: what the robot does is not known.")


def change(wall: datetime, what: str, sentence: str) -> NewsLine:
    """Return the line of a change without an event. `what` names its subject."""
    report = {"time": wall.isoformat(), "kind": "change", "what": what, "detail": sentence}
    return NewsLine(wall, what, sentence, json.dumps(report, ensure_ascii=False))


class _Follower(Receiver):
    """Prints what is received, on the receiving threads: a slow reader delays only this program."""

    def __init__(self, show: Callable[[NewsLine], None]) -> None:
        self._show = show
        self._lock = threading.Lock()
        self.changes = StatusChanges()

    def say(self, lines: Iterator[NewsLine]) -> None:
        """Show these lines together, in order."""
        with self._lock:
            for line in lines:
                self._show(line)

    def received_state(self, state: GatewayState, received_ns: int) -> None:
        self.say(self.changes.received_state(state, received_ns, _wall()))

    def received_event(self, event: Event, left_out: int = 0) -> None:
        del left_out  # always 0: no event is dropped
        self.say(self.changes.received_event(event, time.monotonic_ns(), _wall()))

    def received_token(self, alive: bool) -> None:
        self.say(self.changes.received_token(alive, time.monotonic_ns(), _wall()))

    def answered(self, client: Client) -> None:
        count = len(client.answerers(keys.STATE, _OTHERS_S))
        if count > 1:
            self.say(self.changes.note(several_answer(count, keys.STATE), _wall()))

    def diagnosed(self, reasons: list[str]) -> None:
        for each in reasons if not self.changes.receives else ():
            self.say(self.changes.note(each, _wall()))


def follow(reach: Reach, *, as_json: bool) -> NoReturn:
    """Print lines until Ctrl-C, SIGTERM, or the end of their reader, then end the process.

    Waits for a gateway that does not run yet. Raises ConfigError, before the first line, for a faulty file.
    """
    connect, zenoh_config, timeout_s = reach
    config = client_config(connect, zenoh_config)  # a faulty file is reported at once
    ended = threading.Event()

    def show(line: NewsLine) -> None:
        try:
            sys.stdout.write(f"{line.as_json if as_json else line.plain}\n")
            sys.stdout.flush()
        except OSError:  # the reader has gone
            ended.set()

    source = "hexapod-gateway status"
    client = partial(Client, connect, zenoh_config=zenoh_config, source=source, timeout_s=timeout_s, explain=False)
    follower = _Follower(show)
    # With a link, the gateway is frozen, or there is none behind the router.
    unreached = partial(why.unreached, connect, zenoh_config)
    link = Live(client, follower, lambda found: [] if found is not None and found.connected else unreached())
    if (expiring := diagnosis.own_expiry(config)) is not None:
        hint(f"{expiring}; {certs.renewal('NAME')}")
    with on_end_signals(ended.set):
        link.start()
        while not ended.wait(_POLL_S):
            follower.say(follower.changes.poll(time.monotonic_ns(), _wall()))
        link.close()
    # The interpreter's own end aborts while a thread is inside Zenoh, which may take ten seconds.
    os._exit(0)


def _wall() -> datetime:
    return datetime.now().astimezone()
