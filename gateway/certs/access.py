"""Access by role: common names, one table of the messages that people and a robot may exchange, and the Zenoh files.

Zenoh's access control identifies a laptop by its whole common name, without patterns. So each laptop has a common name
of its own, such as `operator-07`, which can be revoked alone. The rules in gateway.json5 name roles; the gateway
replaces each role by its common names when it starts (`robot/runtime/revocations.py`), so that a new laptop needs no
change on the robot.

For declarations of clients, keys are exact: Zenoh keeps each accepted declaration and compares it with all others. An
observer who may declare `hexapod/*` could declare 20 000 keys, which would delay Stops. For messages, and for the
gateway's own declarations, a wildcard is cheap, and docs/interface.md promises it: a put on `hexapod/leg/*/cmd` means
every leg.

Zenoh compares a rule's keys with those on the wire, which begin with the robot's namespace. Each role is tried with
real sessions (tests/zenoh/test_security.py).
"""

import hashlib
import json
import re
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

from gateway.certs import BUTTON, LAPTOP_ROLES, OPERATOR
from gateway.zenoh import limits
from schemas import keys
from schemas.keys import ALIVE, ALL_COMMANDS, ASKABLE, CALIBRATION, ESTOP, PUBLISHED, SIM_BODY, SIM_UPRIGHT

MOST: Final = 1000
"""Common names of each role. A laptop keeps its common name for ever, also when it is revoked."""

NOBODY: Final = "(nobody)"
"""A common name without a certificate, for a subject whose names are all revoked: to Zenoh, a subject without names
means everyone."""

_COMMON_NAME: Final = re.compile(rf"\A({'|'.join(LAPTOP_ROLES)})-\d{{2,3}}\Z")


def every(role: str) -> list[str]:
    """Return all common names of a role."""
    return [f"{role}-{number:02}" for number in range(MOST)]


def role_of(common_name: str) -> str:
    """Return a laptop's role; for any other common name (`gateway`, `console`), the name itself."""
    return _COMMON_NAME.sub(r"\1", common_name)


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


def _lists() -> str:
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


# ---- gateway.json5 for the robot, NAME.json5 for a laptop. Paths in them are relative to the file's own folder

_GATEWAY = """\
// The gateway's Zenoh configuration, made by `hexapod-gateway certs` for @HOSTS@.
// The robot needs this file, ca.pem, gateway.pem and gateway.key in one folder. Keep ca.key elsewhere: it admits all.
{
  mode: "peer",
  // All addresses, IPv4 and IPv6. On a kernel without IPv6: tls/0.0.0.0:@PORT@
  listen: { endpoints: ["tls/[::]:@PORT@"] },
  connect: { endpoints: [] },
  scouting: { multicast: { enabled: false }, gossip: { enabled: false } },
  adminspace: { enabled: false },
  transport: {
    unicast: { max_sessions: @MAX_SESSIONS@, accept_timeout: @ACCEPT_TIMEOUT_MS@ },
    shared_memory: { enabled: false },  // it would go around the size limit
    link: {
      protocols: ["tls"],
      // A link that is silent for this long (ms) is dead, and what waited on it is dropped with it.
      tx: { lease: 1000 },
      // Limit in bytes of a message of fragments.
      rx: { max_message_size: @MAX_MESSAGE_SIZE@ },
      tls: {
        root_ca_certificate: "ca.pem",
        listen_certificate: "gateway.pem",
        listen_private_key: "gateway.key",
        connect_certificate: "gateway.pem",  // where the gateway dials another Zenoh program
        connect_private_key: "gateway.key",
        enable_mtls: true, verify_name_on_connect: true, close_link_on_expiration: true,
      },
    },
  },
  // At its start the gateway replaces each role by its laptops' common names (operator-00, operator-01, …) without the
  // revoked ones, so a new laptop needs no change here. Keys are exact: subscribe to hexapod/state, not to hexapod/*.
  access_control: {
    enabled: true, default_permission: "deny",
@ACCESS@  },
  // The gateway answers payloads over 4096 bytes with `too_large`; far larger ones are dropped before they reach it.
  low_pass_filter: [
    { id: "size", flows: ["ingress"], messages: ["put", "delete", "query", "reply"], key_exprs: ["**"],
      size_limit: @SIZE_LIMIT@ },
  ],
}
"""

_MARK = b"// `setup` renews the access rules of an unedited file. SHA-256 of the lines above: "

_LAPTOP = """\
// @NAME@ as @ROLE@, made by `hexapod-gateway certs issue`.
//   hexapod-gateway status --zenoh-config @FILE@
// Paths are relative to this file's folder: keep ca.pem, @NAME@.pem and @NAME@.key there.
{
  mode: "client",
  connect: { endpoints: @ENDPOINTS@, retry: { period_init_ms: 100, period_max_ms: 500, period_increase_factor: 1.5 } },
  scouting: { multicast: { enabled: false }, gossip: { enabled: false } },
  transport: {
    // How long one host may take, name and handshake included. By default it would delay the next one by 10 s.
    unicast: { open_timeout: 1000 },
    shared_memory: { enabled: false },
    link: {
      protocols: ["tls"],
      // The laptop's lease decides how soon a cut is noticed. With 1000 ms, what waited for 3 s is not sent late.
      tx: { lease: 1000 },
      rx: { max_message_size: @MAX_MESSAGE_SIZE@ },
      tls: {
        root_ca_certificate: "ca.pem",
        connect_certificate: "@NAME@.pem",
        connect_private_key: "@NAME@.key",
        enable_mtls: true, verify_name_on_connect: true,
      },
    },
  },
}
"""


def gateway_json5(hosts: Sequence[str], port: int) -> bytes:
    """Return the robot's Zenoh configuration: mTLS on all addresses, access by role, a size limit, no scouting."""
    return marked(_fill(_GATEWAY, HOSTS=", ".join(hosts), PORT=port, ACCESS=_lists()))


def is_unedited(config: bytes) -> bool:
    """Return whether a gateway.json5 is as `gateway_json5` made it, in this release or an earlier one."""
    text, begin, _ = config.rpartition(_MARK)
    return bool(begin) and config == marked(text)


def marked(text: bytes) -> bytes:
    """Return a gateway.json5 with the line by which `is_unedited` recognises it."""
    return text + _MARK + hashlib.sha256(text).hexdigest().encode() + b"\n"


def laptop_json5(name: str, role: str, endpoints: Sequence[str], file: str) -> bytes:
    """Return a laptop's Zenoh configuration, with the name `file`, that dials these endpoints of a robot."""
    return _fill(_LAPTOP, NAME=name, FILE=file, ROLE=role, ENDPOINTS=json.dumps(endpoints))


def endpoint(host: str, port: int) -> str:
    """Return Zenoh's TLS endpoint, with brackets for an IPv6 address."""
    return f"tls/[{host}]:{port}" if ":" in host else f"tls/{host}:{port}"


def _fill(template: str, **values: object) -> bytes:
    """Return the template with each @NAME@ replaced by its value, or by the limit of this name."""
    known = vars(limits) | values
    return re.sub("@([A-Z_]+)@", lambda found: str(known[found[1]]), template).encode()
