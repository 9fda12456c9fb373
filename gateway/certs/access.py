"""Access by role: the laptops' common names, and one table of the messages that people and a robot may exchange.

Zenoh's access control identifies a laptop by its whole common name, without patterns. So each laptop has a common name
of its own, such as `operator-07`, which can be revoked alone. The rules in gateway.json5 name roles; the gateway
replaces each role by its common names when it starts (`robot/zenoh_io/revoked.py`), so that a new laptop needs no
change on the robot.

For declarations of clients, keys are exact: Zenoh keeps each accepted declaration and compares it with all others. An
observer who may declare `hexapod/*` could declare 20 000 keys, which would delay Stops. For messages, and for the
gateway's own declarations, a wildcard is cheap, and docs/interface.md promises it: a put on `hexapod/leg/*/cmd` means
every leg.

Zenoh compares a rule's keys with those on the wire, which begin with the robot's namespace.
"""

import json
import re
from typing import Any, Final, NamedTuple

from gateway.certs import BUTTON, LAPTOP_ROLES, OPERATOR
from schemas import keys
from schemas.keys import ALIVE, ALL_COMMANDS, ASKABLE, CALIBRATION, ESTOP, PUBLISHED, SIM_BODY, SIM_UPRIGHT

MOST: Final = 1000
"""Common names of each role. A laptop keeps its common name for ever, also when it is revoked."""

NOBODY: Final = "(nobody)"
"""A common name without a certificate, for a subject whose names are all revoked: to Zenoh, a subject without names
means everyone."""

_COMMON_NAME: Final = re.compile(rf"({'|'.join(LAPTOP_ROLES)})-\d{{2,3}}")


def every(role: str) -> list[str]:
    """Return all common names of a role."""
    return [f"{role}-{number:02}" for number in range(MOST)]


def role_of(common_name: str) -> str:
    """Return a laptop's role; for any other common name (`gateway`, `console`), the name itself."""
    found = _COMMON_NAME.fullmatch(common_name)
    return common_name if found is None else found[1]


class Traffic(NamedTuple):
    """Messages that may pass between people and a robot, in one direction."""

    what: str
    from_people: bool
    messages: tuple[str, ...]
    keys: tuple[str, ...]
    roles: tuple[str, ...] = LAPTOP_ROLES
    """The people's roles."""


_DECLARED: Final = ("declare_subscriber", "declare_queryable")
# fmt: off
TRAFFIC: Final = (
    Traffic("commands", True, ("put", "delete", "query"), (ALL_COMMANDS,), (OPERATOR,)),
    Traffic("acknowledgements", False, ("reply",), (ALL_COMMANDS,), (OPERATOR,)),
    Traffic("commands that it takes", False, _DECLARED, (ALL_COMMANDS,), (OPERATOR,)),
    Traffic("setting a simulated robot upright", True, ("query",), (SIM_UPRIGHT,), (OPERATOR,)),
    Traffic("set upright", False, ("reply", "declare_queryable"), (SIM_UPRIGHT,), (OPERATOR,)),
    Traffic("presses", True, ("put",), (ESTOP,), (BUTTON,)),
    Traffic("presses and check-ins", True, ("query",), (ESTOP, keys.BUTTON), (BUTTON,)),
    Traffic("acknowledgements of these", False, ("reply",), (ESTOP, keys.BUTTON), (BUTTON,)),
    Traffic("presses that it takes", False, _DECLARED, (ESTOP,), (BUTTON,)),
    Traffic("check-ins that it takes", False, ("declare_queryable",), (keys.BUTTON,), (BUTTON,)),
    Traffic("watching", True, ("declare_subscriber",), PUBLISHED),
    Traffic("telemetry", False, ("put",), PUBLISHED),
    Traffic("asking for reports", True, ("query",), ASKABLE),
    Traffic("reports as an answer", False, ("reply", "declare_queryable"), ASKABLE),
    Traffic("asking who is alive", True, ("declare_liveliness_subscriber", "liveliness_query"), (ALIVE,)),
    Traffic("alive", False, ("liveliness_token",), (ALIVE,)),
)
# fmt: on

BODY: Final = (
    Traffic("a simulated body", True, ("put",), (SIM_BODY,)),
    Traffic("who watches it", False, ("declare_subscriber",), (SIM_BODY,)),
    Traffic("asking for the calibration", True, ("declare_subscriber", "query"), (CALIBRATION,)),
    Traffic("the calibration", False, ("put", "reply", "declare_queryable"), (CALIBRATION,)),
    Traffic("that it can be set upright", True, ("declare_queryable", "reply"), (SIM_UPRIGHT,)),
    Traffic("setting it upright", False, ("query",), (SIM_UPRIGHT,)),
)
"""Traffic between a gateway and the process that simulates its robot's body."""


def lists() -> str:
    """Return the lists of Zenoh's access control for TRAFFIC as JSON5: rules, subjects and policies, one a line."""
    made = {
        "rules": [rule(each, "") for each in TRAFFIC],
        "subjects": [{"id": role, "cert_common_names": [role]} for role in LAPTOP_ROLES],
        "policies": [
            {"subjects": roles, "rules": [each.what for each in TRAFFIC if each.roles == roles]}
            for roles in dict.fromkeys(each.roles for each in TRAFFIC)
        ],
    }
    lines = {name: "".join(f"      {json.dumps(each)},\n" for each in entries) for name, entries in made.items()}
    return "".join(f"    {name}: [\n{text}    ],\n" for name, text in lines.items())


def rule(each: Traffic, namespace: str) -> dict[str, Any]:
    """Return one rule with the fields of Zenoh's configuration, its keys in `namespace` ("": none)."""
    return {
        "id": each.what,
        "permission": "allow",
        "flows": ["ingress" if each.from_people else "egress"],
        "messages": each.messages,
        "key_exprs": [f"{namespace}/{key}" if namespace else key for key in each.keys],
    }
