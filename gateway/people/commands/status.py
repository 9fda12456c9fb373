"""`hexapod-gateway status`: one look at the state, in sentences or as published; `follow` has what comes after it."""

import sys

from gateway import certs
from gateway.people.client.dangers import PowerAlarm, power_now
from gateway.people.commands.options import Reach
from gateway.people.terminal import say
from gateway.people.walking import robot_now
from schemas.telemetry import GatewayState, LegReport


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
