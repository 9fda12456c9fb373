"""`hexapod-gateway status`: one look at the state, in sentences or as published."""

import sys
from pathlib import Path

from gateway.people.client.dangers import PowerAlarm, power_now
from gateway.people.terminal import say
from gateway.people.tools.reach import connection
from gateway.people.walking import robot_now
from schemas.telemetry import GatewayState, LegReport


def status(connect: str | None, zenoh_config: Path | None, timeout_s: float, *, as_json: bool) -> None:
    """Print it. Raises ZenohError where no gateway answers."""
    with connection(connect, zenoh_config, timeout_s, source="status")() as client:
        state = client.state()
    if as_json:
        sys.stdout.write(f"{state.model_dump_json()}\n")
        return
    for sentence in sentences(state):
        say(sentence)


def sentences(state: GatewayState) -> list[str]:
    """What a person asks first, a line each: may it move, what runs, who drives, what has gone wrong."""
    found = [f"{robot_now(state)}. Gateway {state.version}, up {state.uptime_s:.0f} s."]
    found += (_leg(leg) for leg in state.legs if any(servo.running for servo in leg.servos))
    lease, buttons, spi, watchdog = state.lease, state.buttons, state.spi, state.watchdog
    if lease.holder is not None:
        found.append(f"{lease.holder} {'drives' if lease.held_s is not None else 'is handed the lease'}.")
    if buttons.required or buttons.alive:
        found.append(f"Stop buttons: {buttons.alive} alive, {buttons.required} required.")
    if state.calibration.fault is not None:
        found.append(f"Nothing can be started: {state.calibration.fault}")
    device = "a simulated controller" if state.simulated else spi.device
    spoken = state.protocol if spi.framing == "none" else spi.framing
    found.append(f"{spi.frames} frames to {device} ({spoken}), {spi.errors} SPI errors.")
    controller, battery = state.controller, state.battery
    if controller.alive is not None:
        silence = "" if controller.age_ms is None else f", its last answer {controller.age_ms / 1000:.1f} s ago"
        found.append(
            f"The controller ({controller.protocol}) {'is alive' if controller.alive else f'is SILENT{silence}'}."
        )
    if battery is not None:
        found.append(f"Battery: {battery.voltage_v:.2f} V, {battery.percent:.0f} %.")
    if state.power is not None:
        alarm = PowerAlarm()
        alarm.received_state(state, 0)
        found.append(" ".join((f"Power ({state.power.interface}): {power_now(state.power)}.", alarm.sentence)).strip())
    found.append(
        f"{state.commands.accepted} commands accepted, {state.commands.rejected} rejected; "
        f"the watchdog ({watchdog.timeout_ms:g} ms) has stopped {watchdog.expirations} legs."
    )
    if state.incident is not None:
        found.append(f"Latest incident: {state.incident} (hexapod-gateway incidents show {state.incident}).")
    return found


def _leg(leg: LegReport) -> str:
    angles = ", ".join(f"{servo.angle_deg:g}°" if servo.running else "off" for servo in leg.servos)
    by = "" if leg.source is None else f", by {leg.source}"
    return f"Leg {leg.leg} runs at {angles}{by}."
