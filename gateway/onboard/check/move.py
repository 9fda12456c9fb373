"""`check --move`: first contact. Start one servo through the running gateway, move it by 5°, and stop it.

A person agrees first, and nothing else may run. Every end stops the servo; if that fails, the gateway's watchdog does.

The servo is stopped as by an emergency stop: six Stops in one call. Some SPI drivers do not release chip select between
the transfers of a call. A controller that needs this obeys only the first Stop. SPI reports nothing back, so a person
is asked whether the servo is loose.
"""

import math
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Final

from gateway.errors import ConfigError
from gateway.model.protocols import BUILT_IN
from gateway.onboard.check.bench import Bench
from gateway.onboard.computer import SELECT_BY_GPIO
from gateway.own_command import command
from gateway.people.commands.moving import ServoMotion, consent, lying, ready, stopped_after
from gateway.people.commands.reach import Connection, drives, show_differences
from gateway.people.terminal import ask, say
from schemas.robot import LEGS, MAX_DEG, SERVO_IDS
from schemas.telemetry import Telemetry

_SERVO: Final = 61
"""The default servo. Its leg's Stop is the last of six in a call."""
_ANGLE_DEG: Final = 90.0
_HOLD_S: Final = 1.5
"""The pause at each angle. A servo reaches it from anywhere, and a person sees it."""
_REST_S: Final = 0.5
"""The time for some reports of currents at rest: ten a second are published."""
_LEAST_RISE_A: Final = 0.05
"""A servo draws about 8 mA at rest, and at least 100 mA while it moves."""
_PERIOD_S: Final = 0.05
"""A fifth of the default watchdog timeout."""
_HOLDS: Final = (
    "A Stop does not reach it together with others: the driver of this SPI bus does not release chip select between "
    "the transfers of one call, and of six Stops the controller obeys the first. AN EMERGENCY STOP WOULD STOP ONE LEG. "
    f"To have all stop, {SELECT_BY_GPIO}. It was now stopped alone: if it still holds, switch its power off."
)
_WHOLE_HOLDS: Final = (
    "The shutdown does not reach the controller: AN EMERGENCY STOP WOULD STOP NOTHING. Switch the servos' power off, "
    "and see that the Pi's TX leads to the controller's RX (controller.uart names the UART)."
)
# fmt: off
_BOARD, _ALL, _LEGS, _WHOLE = "board", "all", "legs", "whole"
_CAUSES: Final = (
    (_BOARD, "power.servos: did another servo move, or is one stiff? Exchange them there, and restart it."),
    (_ALL, "Supply: have the servos one of their own, and is it on? A servo that runs holds against your hand."),
    (_LEGS, "Framing: the gateway speaks {spi.framing}. The published STM32 firmware needs length-prefixed (plain "
            "makes it deaf), one that follows the protocol's document plain. Know which is there, then change it."),
    (_LEGS, "Reset: has the controller ever received the wrong framing? Then it is deaf until its reset: set the right "
            "one, restart the gateway, and reset the controller (its reset button, or power)."),
    (_LEGS, "Wiring: do MOSI, SCLK and GND lead from the Pi to the controller, and have the servos the same ground?"),
    (_LEGS, "Chip select: the gateway writes to {spi.device}; CE0 is /dev/spidev0.0, CE1 is /dev/spidev0.1."),
    (_WHOLE, "UART: does the Pi's TX lead to the controller's RX? Its heartbeat comes by the other wire."),
    (_WHOLE, "Wiring: does MOSI lead from the Pi to the controller? Its answers come by MISO, so SCLK works."),
    (_ALL, "The servo: is it plugged in at the place of its id (the leg, then the joint)? Try another one."),
)
# fmt: on
"""Why a servo may stand still although every frame was written, the likeliest first, and for which robots."""


def move(connect: Connection, *, agreed: bool) -> int:
    """Ask, move, stop, and ask what was seen. Return 0 if a person saw it move, else 1.

    Raises ConfigError if nothing may be moved, FailedError if a command is rejected. `agreed`: ask nothing; 0 then
    means only that all commands were accepted.
    """
    with connect() as client:
        state = ready(client)
        show_differences()
        whole, measured = state.wire.whole_robot, list[Telemetry]()
        if whole and not state.controller.alive:
            raise ConfigError(f"the controller does not answer, and nothing is moved: {command('status')} names why")
        motion = _motion(lying(client, state) if whole else {}, agreed=agreed)
        which = "all servos are" if whole else f"{motion.which} is"
        consent(motion, state, agreed=agreed)
        state = ready(client)  # the questions took their time
        # If supply is what starts a servo, the one at that output moves, whichever it is.
        if shows_output := state.power is not None and not state.wire.supply_starts:
            _subscriber = client.on_telemetry(measured.append)
            time.sleep(_REST_S)
        at_rest = len(measured)

        def stop() -> str:  # alone in its call
            ack = client.stop() if whole else client.servo(motion.servo_id, "stop")
            end = "stopped." if ack.accepted else f"not stopped: {ack.reason}: {ack.detail}"
            return f"{which.capitalize()} {end}"

        with drives(client, _HOLD_S, moves=True), stopped_after(which, stop):
            _move(Bench(client, motion), state.watchdog.timeout_ms)
            if state.simulated:
                say("A simulated controller took it: no servo is there to move.")
            say(f"All six legs were stopped at once, {motion.which} with them.")
            if shows_output:
                say(output(measured[:at_rest], measured[at_rest:], motion.servo_id))
            if agreed:
                say("Every frame was written, and SPI has no way back: look whether it moved, and whether it is loose.")
                return 0
            seen = ask("Did it move? yes or no: ")
            loose = ask("Turn its horn gently with a finger: is it loose now? yes or no: ") if seen == "yes" else ""
    if seen == "no":
        say("The gateway wrote every frame, and SPI has no way back: one of these, the likeliest first.")
        of = {_ALL, _WHOLE if whole else _LEGS, _ALL if state.power is None else _BOARD}
        of -= {_LEGS, _WHOLE} if state.wire.name not in BUILT_IN else set()  # which are about SPI
        for place, text in enumerate((text for robots, text in _CAUSES if robots in of), 1):
            say(f"{place}. {text.format(spi=state.spi)}")
    if loose == "no":
        say(_WHOLE_HOLDS if whole else _HOLDS)
    if loose == "yes":
        say(f"Then everything from here to {motion.which} works.")
        if motion.leg == LEGS[0] and not whole:
            say("Its Stop was the first of six in one call: try a servo of leg 6, to see whether the others arrive.")
    return int(loose != "yes")


def _move(bench: Bench, timeout_ms: float) -> None:
    """Start the servo, repeat each angle for `_HOLD_S`, and stop all. Raises FailedError."""
    bench.start()  # only once: a set is rejected for what somebody else has stopped
    for angle_deg in (bench.motion.start_deg, bench.motion.end_deg):
        end_s = time.monotonic() + _HOLD_S
        while time.monotonic() < end_s:
            bench.ask("set", angle_deg)
            time.sleep(min(_PERIOD_S, timeout_ms / 5000))
    bench.demand(bench.client.stop(), "a Stop")


def output(rest: Sequence[Telemetry], moving: Sequence[Telemetry], servo_id: int) -> str:
    """Return a sentence on what the power board's currents, at rest and later, show for a servo that was moved."""

    def peak_a(reports: Sequence[Telemetry], unknown_a: float) -> float:
        servos = (each.servos.get(str(servo_id)) for each in reports if each.servos)
        return max((each.current_a for each in servos if each and each.current_a is not None), default=unknown_a)

    rise_a = peak_a(moving, 0.0) - peak_a(rest, math.inf)
    if rise_a >= _LEAST_RISE_A:
        return f"The power board's output for servo {servo_id} feeds it ({rise_a * 1000:.0f} mA more than at rest)."
    return (
        f"The power board has measured no current of servo {servo_id}: its output in power.servos feeds another "
        "servo, or none. If it did not move, see by the plugs which one it is, and exchange the two."
    )


def _motion(held: Mapping[int, float], *, agreed: bool) -> ServoMotion:
    """Ask which servo goes where. Raises ConfigError for a wrong servo or angle."""
    text = ("" if agreed else ask(f"Which servo, 11 to 63? [{_SERVO}] ")) or str(_SERVO)
    if not (text.isdigit() and int(text) in SERVO_IDS):
        raise ConfigError(f"{text!r} is no servo: the leg, 1 to 6, then the joint, 1 to 3")
    usual_deg = held.get(int(text), _ANGLE_DEG)
    angle = ("" if agreed else ask(f"Start it at which angle? [{usual_deg:g}] ")) or str(usual_deg)
    with suppress(ValueError):
        if 0 <= float(angle) <= MAX_DEG:
            return ServoMotion(int(text), float(angle), held)
    raise ConfigError(f"{angle!r} is no angle: 0 to 180 degrees")
