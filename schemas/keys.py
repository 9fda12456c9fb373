"""The Zenoh keys of one robot: building and parsing them.

A fleet's prefix is Zenoh's own `namespace` setting; it never appears here.
"""

import json
from enum import StrEnum
from typing import Final, NamedTuple

from schemas.robot import LEGS, SERVO_IDS

ROOT: Final = "hexapod"
MAX_SOURCE: Final = 64
"""Characters of `source`. A message with a longer one is rejected."""
ALL_COMMANDS: Final = f"{ROOT}/**/cmd"
LEGS_COMMAND: Final = f"{ROOT}/legs/cmd"
ESTOP: Final = f"{ROOT}/estop/cmd"
RESET: Final = f"{ROOT}/reset/cmd"
LEASE: Final = f"{ROOT}/lease/cmd"
CALIBRATION_CMD: Final = f"{ROOT}/calibration/cmd"
REVOCATION: Final = f"{ROOT}/revocation/cmd"
BUTTON: Final = f"{ROOT}/button/cmd"
GET_ONLY: Final = {
    LEASE: "only its sender may receive the answer",
    CALIBRATION_CMD: "its sender needs the result",
    REVOCATION: "its sender needs the result",
    BUTTON: "a check-in without an answer does not count",
}
"""Keys that take `get` only, and why. They move nothing, so they are not in COMMAND_KEYS."""
STATE: Final = f"{ROOT}/state"
CONFIG: Final = f"{ROOT}/config"
EVENT: Final = f"{ROOT}/event"
FRAME: Final = f"{ROOT}/frame"
CALIBRATION: Final = f"{ROOT}/calibration"
TELEMETRY: Final = f"{ROOT}/telemetry"
ALIVE: Final = f"{ROOT}/alive"
SIM_BODY: Final = f"{ROOT}/sim/body"
SIM_UPRIGHT: Final = f"{ROOT}/sim/upright"
"""Puts a simulated robot on its feet; takes `get` only."""

GATEWAYS: Final = (STATE, CONFIG, EVENT, FRAME, CALIBRATION, TELEMETRY)
"""Published by the gateway itself."""
PUBLISHED: Final = (*GATEWAYS, SIM_BODY)
"""Published for all roles."""
ASKABLE: Final = (STATE, CONFIG, CALIBRATION, TELEMETRY)
"""Of these, also answered to `get`."""


class Target(StrEnum):
    """The kind of object that a command key addresses."""

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
    """Return the command key of `leg`, 1 to 6. Raises ValueError for any other."""
    if leg not in LEGS:
        raise _no_leg(leg)
    return f"{ROOT}/leg/{leg}/cmd"


def servo_command(servo_id: int) -> str:
    """Return the command key of a servo: leg 1-6, then joint 1-3, so 11 to 63. Raises ValueError for any other."""
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
    """Parse a command key. Raises ValueError with a sentence that describes valid keys."""
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
    """Return the sender's text on one line, cut to `_MAX_ECHO` characters."""
    quoted = text if text and text.isprintable() else json.dumps(text)
    return quoted if len(quoted) <= _MAX_ECHO else quoted[:_MAX_ECHO] + "…"
