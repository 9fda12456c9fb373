"""The Zenoh files for the certificates: gateway.json5 for the robot, NAME.json5 for a laptop.

Their paths are relative to the file's own folder (gateway/zenoh_config.py), so the folder can be copied and unzipped
anywhere. Each role is tried with real sessions (tests/zenoh/test_security.py).
"""

import hashlib
import json
import re
from collections.abc import Sequence

from gateway import limits
from gateway.certs import access

_GATEWAY = """\
// The gateway's Zenoh configuration, made by `hexapod-gateway certs` for @HOSTS@.
// In gateway.toml:  [zenoh]  config = "/etc/hexapod-gateway/zenoh/gateway.json5"
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
    return marked(_fill(_GATEWAY, HOSTS=", ".join(hosts), PORT=port, ACCESS=access.lists()))


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
