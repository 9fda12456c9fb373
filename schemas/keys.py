"""The Zenoh keys of one robot: build them, and tell what a key addresses.

A fleet's prefix is Zenoh's own `namespace` setting; it never appears here.
"""

import json
from enum import StrEnum
from typing import Final, NamedTuple

from schemas.robot import LEGS, SERVO_IDS

ROOT: Final = "hexapod"
MAX_SOURCE: Final = 64
"""Characters of the name by which somebody commands. A longer one is rejected, and all that carries it."""
ALL_COMMANDS: Final = f"{ROOT}/**/cmd"
LEGS_COMMAND: Final = f"{ROOT}/legs/cmd"
ESTOP: Final = f"{ROOT}/estop/cmd"
RESET: Final = f"{ROOT}/reset/cmd"
LEASE: Final = f"{ROOT}/lease/cmd"
"""Who is driving."""
CALIBRATION_CMD: Final = f"{ROOT}/calibration/cmd"
"""Changes the calibration."""
REVOCATION: Final = f"{ROOT}/revocation/cmd"
"""Shuts certificates out."""
BUTTON: Final = f"{ROOT}/button/cmd"
"""Who watches with a hand on a stop."""
GET_ONLY: Final = {
    LEASE: "its answer is for one alone",
    CALIBRATION_CMD: "whoever changes it has to know what became of it",
    REVOCATION: "whoever shuts somebody out has to know what became of it",
    BUTTON: "a check-in that is not answered is none",
}
"""They take `get` only, and why; they command nothing that moves, so they are none of COMMAND_KEYS."""
STATE: Final = f"{ROOT}/state"
EVENT: Final = f"{ROOT}/event"
FRAME: Final = f"{ROOT}/frame"
CALIBRATION: Final = f"{ROOT}/calibration"
ALIVE: Final = f"{ROOT}/alive"
SIM_BODY: Final = f"{ROOT}/sim/body"
"""Where a simulated robot's body is."""
SIM_UPRIGHT: Final = f"{ROOT}/sim/upright"
"""Puts it on its feet; takes `get` only."""

GATEWAYS: Final = (STATE, EVENT, FRAME, CALIBRATION)
"""What the gateway itself publishes."""
PUBLISHED: Final = (*GATEWAYS, SIM_BODY)
"""What is published for all who may watch."""
ASKABLE: Final = (STATE, CALIBRATION)
"""Of these, what a watcher may also `get`."""


class Target(StrEnum):
    """What a command key addresses."""

    LEG = "leg"
    SERVO = "servo"
    LEGS = "legs"
    ESTOP = "estop"
    RESET = "reset"


class CommandKey(NamedTuple):
    """A parsed command key; `number` is the leg (1-6), the servo id (11-63), or 0 where the key has none."""

    target: Target
    number: int = 0


def _no_leg(text: object) -> ValueError:
    return ValueError(f"leg {text} does not exist; legs are 1 to 6")


def _no_servo(text: object) -> ValueError:
    return ValueError(f"servo {text} does not exist; an id is the leg (1 to 6) and the joint (1 to 3), such as 32")


def leg_command(leg: int) -> str:
    """The command key of `leg`, 1 to 6. Raises ValueError for any other."""
    if leg not in LEGS:
        raise _no_leg(leg)
    return f"{ROOT}/leg/{leg}/cmd"


def servo_command(servo_id: int) -> str:
    """The command key of a servo: leg 1-6, then joint 1-3, so 11 to 63. Raises ValueError for any other."""
    if servo_id not in SERVO_IDS:
        raise _no_servo(servo_id)
    return f"{ROOT}/servo/{servo_id}/cmd"


COMMAND_KEYS: Final = {
    LEGS_COMMAND: CommandKey(Target.LEGS),
    **{leg_command(leg): CommandKey(Target.LEG, leg) for leg in LEGS},
    **{servo_command(servo_id): CommandKey(Target.SERVO, servo_id) for servo_id in SERVO_IDS},
    ESTOP: CommandKey(Target.ESTOP),
    RESET: CommandKey(Target.RESET),
}
"""Every command key, in the order in which commands of one instant apply: `legs`, then `leg`, then `servo`."""


def parse(key: str) -> CommandKey:
    """What `key` addresses. Raises ValueError with a sentence that says what a right key looks like."""
    found = COMMAND_KEYS.get(key)
    if found is not None:
        return found
    match key.split("/"):
        case [_, "leg", number, "cmd"]:
            raise _no_leg(_short(number))
        case [_, "servo", number, "cmd"]:
            raise _no_servo(_short(number))
        case _ if key in GET_ONLY:
            raise ValueError(f"{key} takes get only: {GET_ONLY[key]}")
        case _:
            raise ValueError(f"{_short(key)} is no command key; they are leg/1..6, servo/11..63, legs, estop and reset")


_MAX_ECHO: Final = 60


def _short(text: str) -> str:
    """The sender's own text on one line, and not much of it."""
    quoted = text if text and text.isprintable() else json.dumps(text)
    return quoted if len(quoted) <= _MAX_ECHO else quoted[:_MAX_ECHO] + "…"
