"""`hexapod-gateway status`: one look at the state, or with `--follow` a line for each change, until a signal."""

import json
import os
import sys
import threading
import time
from collections.abc import Callable
from datetime import datetime
from functools import partial
from typing import Final, NamedTuple, NoReturn

from gateway import certs
from gateway.host import output
from gateway.people.client import diagnosis
from gateway.people.client.blocking import Client
from gateway.people.commands import reach, why
from gateway.people.commands.options import Reach
from gateway.people.terminal import hint, on_end_signals, say
from gateway.people.walking.words import robot_now
from gateway.people.watching.dangers import PowerAlarm, power_now
from gateway.people.watching.live import Live, Receiver
from gateway.rate_limit import NS_PER_S
from gateway.words.own_command import this_command
from gateway.words.text import visible
from gateway.zenoh.config import client_config
from schemas import keys
from schemas.event import Event
from schemas.gateway_state import GatewayState, LegReport


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
        charge = "" if battery.percent is None else f", {battery.percent:.0f} %"
        found.append(f"Battery: {battery.voltage_v:.2f} V{charge}.")
    alarm = PowerAlarm()
    alarm.received_state(state, 0)
    found.append(f"{asked['power']} {alarm.sentence}".strip())
    found.append(
        f"Commands accepted: {state.commands.accepted}, rejected: {state.commands.rejected}, "
        f"passed over: {state.commands.passed_over}, lost: {state.commands.lost}; "
        f"legs stopped by the watchdog ({watchdog.timeout_ms:g} ms): {watchdog.expirations}."
    )
    found += (asked["address"], asked["certificate"])
    if state.incident is not None:
        found.append(f"Latest incident: {state.incident} ({this_command()} incidents show {state.incident}).")
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


SAME_START_S: Final = 0.1
"""Two states of one gateway agree on its start within this time. No gateway restarts this quickly."""
LATE_S: Final = 1.0
"""The longest delay of a state that arrives after a newer one."""


class Follower(Receiver):
    """Shows a line for each change in states and events, on the receiving threads: a slow reader delays only this
    program."""

    def __init__(self, show: Callable[[NewsLine], None], now_ns: Callable[[], int] = time.monotonic_ns) -> None:
        self._show = show
        self._now_ns = now_ns
        self._lock = threading.Lock()
        """Held while the lines of one report are shown."""
        self._known: dict[str, str] = {}
        self._alarm = PowerAlarm()
        self._newest: tuple[float, float, int] | None = None
        """The gateway's start (s since 1970), its uptime (s), and when it was received, by the newest state."""
        self._received_ns: int | None = None
        self._silent = False
        self._said: set[str] = set()
        """Sentences that were shown since the gateway fell silent."""

    def received_state(self, state: GatewayState, received_ns: int) -> None:
        """Show each sentence that differs from the state before."""
        with self._lock:
            self._received(received_ns)
            if self._is_next(state, received_ns):
                self._alarm.received_state(state, received_ns)
                self._changed({**topics(state), "alarm": self._alarm.sentence})

    def received_event(self, event: Event, left_out: int = 0) -> None:
        del left_out  # always 0: no event is dropped
        with self._lock:
            self._received(self._now_ns())
            who = [event.source] if event.source is not None and event.source not in event.detail else []
            text = ": ".join([*who, *([str(event.reason)] if event.reason is not None else []), event.detail])
            text += f" (and {event.left_out} more that are left out)" if event.left_out else ""
            self._show(NewsLine(event.time, str(event.kind), text, event.model_dump_json()))
            self._alarm.received_event(event.kind)
            self._changed({"alarm": self._alarm.sentence})

    def received_token(self, alive: bool) -> None:
        with self._lock:
            if alive:
                self._received(self._now_ns())
            else:
                self._is_silent()

    def answered(self, client: Client) -> None:
        reach.warn_of_others(client, keys.STATE, self.note)

    def diagnosed(self, reasons: list[str]) -> None:
        for each in reasons if self._received_ns is None or self._silent else ():
            self.note(each)

    def note(self, text: str) -> None:
        """Show a sentence about the connection, once until something is received again."""
        with self._lock:
            if text not in self._said:
                self._said.add(text)
                self._change("gateway", text)

    def poll(self) -> None:
        """Show if the gateway has fallen silent. Call several times a second."""
        with self._lock:
            if self._received_ns is not None and self._now_ns() - self._received_ns > SILENT_AFTER_NS:
                self._is_silent()

    def _is_next(self, state: GatewayState, received_ns: int) -> bool:
        """Return whether a state is newer than the newest before it. Show if the gateway was restarted between the two.

        Its uptime is not enough for that: after a silence, the new gateway may have run for longer than the old one
        had. Its time of start is not enough: setting the clock (a Pi's after its boot) moves that of a running gateway.
        """
        began_s, uptime_s = state.time.timestamp() - state.uptime_s, state.uptime_s
        if self._newest is not None:
            before_began_s, before_uptime_s, before_ns = self._newest
            older, apart_s = uptime_s < before_uptime_s, (received_ns - before_ns) / NS_PER_S
            if (older or uptime_s < apart_s + LATE_S) and abs(began_s - before_began_s) >= SAME_START_S:
                self._change("gateway", "The gateway was started again.")
            elif older:
                return False
        self._newest = began_s, uptime_s, received_ns
        return True

    def _changed(self, sentences: dict[str, str]) -> None:
        for what, sentence in sentences.items():
            before, self._known[what] = self._known.get(what, ""), sentence
            if sentence not in ("", before):
                self._change(what, sentence)

    def _received(self, now_ns: int) -> None:
        if self._silent and self._received_ns is not None:
            away_s = (now_ns - self._received_ns) / NS_PER_S
            self._change("gateway", f"The gateway publishes again, after {away_s:.1f} s.")
        if self._silent or self._received_ns is None:
            self._said.clear()
        self._received_ns, self._silent = now_ns, False

    def _is_silent(self) -> None:
        if self._received_ns is not None and not self._silent:
            self._silent = True
            self._change("gateway", "The gateway is SILENT: what the robot does is not known.")

    def _change(self, what: str, sentence: str) -> None:
        """Show a change without an event. `what` names its subject."""
        wall = datetime.now().astimezone()
        report = {"time": wall.isoformat(), "kind": "change", "what": what, "detail": sentence}
        self._show(NewsLine(wall, what, sentence, json.dumps(report, ensure_ascii=False)))


def follow(reach: Reach, *, as_json: bool) -> NoReturn:
    """Print lines until Ctrl-C, SIGTERM, or the end of their reader, then end the process.

    Waits for a gateway that does not run yet. Raises ConfigError, before the first line, for a faulty file.
    """
    connect, zenoh_config, timeout_s = reach
    config = client_config(connect, zenoh_config)  # a faulty file is reported at once
    ended = threading.Event()

    def show(line: NewsLine) -> None:
        sys.stdout.write(f"{line.as_json if as_json else line.plain}\n")
        if output.failed():
            ended.set()

    source = "hexapod-gateway status"
    client = partial(Client, connect, zenoh_config=zenoh_config, source=source, timeout_s=timeout_s, explain=False)
    follower = Follower(show)
    # With a link, the gateway is frozen, or there is none behind the router.
    unreached = partial(why.unreached, connect, zenoh_config)
    link = Live(client, follower, lambda found: [] if found is not None and found.connected else unreached())
    if (expiring := diagnosis.own_expiry(config)) is not None:
        hint(f"{expiring}; {certs.renewal('NAME')}")
    with on_end_signals(ended.set):
        link.start()
        while not ended.wait(_POLL_S):
            follower.poll()
        link.close()
    # The interpreter's own end aborts while a thread is inside Zenoh, which may take ten seconds.
    os._exit(output.finish(0))
