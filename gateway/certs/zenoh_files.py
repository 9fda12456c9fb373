"""The Zenoh files that go with the certificates: gateway.json5 for the robot, NAME.json5 for a laptop.

Paths in them are relative and meant from the file's own folder (gateway/zenoh_config.py), so the folder can be made
on a laptop, copied to a robot, zipped, unzipped elsewhere. Every rule below has a test against real sessions
(tests/test_certs_zenoh.py).
"""

import ipaddress
import json
from collections.abc import Sequence

DEFAULT_PORT = 7447
# Above the gateway's own limit of 4096 bytes: what lies between still reaches it and is answered `too_large`. Beyond
# this, Zenoh drops the message in Rust. The margin leaves room for an attachment, which counts here.
SIZE_LIMIT = 16_384

_GATEWAY = """\
// The gateway's Zenoh configuration, made by `hexapod-gateway certs init` for @HOSTS@.
// In gateway.toml:  [zenoh]  config = "/etc/hexapod-gateway/zenoh/gateway.json5"
// The robot needs this file, ca.pem, gateway.pem and gateway.key. Keep ca.key off the robot: whoever has it can let
// anyone in. Paths are relative to this file's folder.
{
  mode: "peer",
  // All addresses, IPv4 and IPv6. On a kernel without IPv6: tls/0.0.0.0:@PORT@
  listen: { endpoints: ["tls/[::]:@PORT@"] },
  connect: { endpoints: [] },
  // Nobody finds the gateway, or is found by it, by accident.
  scouting: { multicast: { enabled: false }, gossip: { enabled: false } },
  adminspace: { enabled: false },
  transport: {
    // Shared memory would go around the size limit.
    shared_memory: { enabled: false },
    link: {
      protocols: ["tls"],
      // A link that is silent for this long (ms) is dead, and what waited on it is dropped with it.
      tx: { lease: 1000 },
      tls: {
        root_ca_certificate: "ca.pem",
        listen_certificate: "gateway.pem",
        listen_private_key: "gateway.key",
        // For a fleet, where the gateway dials a router.
        connect_certificate: "gateway.pem",
        connect_private_key: "gateway.key",
        enable_mtls: true,
        verify_name_on_connect: true,
        close_link_on_expiration: true,
      },
    },
  },
  // Who may do what. A laptop's certificate carries its role as common name, so a new laptop needs no change here.
  // "**/" in front stands for the robot's namespace, or for nothing. A key expression must contain the whole of what
  // is asked: subscribe to hexapod/state or hexapod/*, not to hexapod/**.
  access_control: {
    enabled: true,
    default_permission: "deny",
    rules: [
      { id: "commands in", permission: "allow", flows: ["ingress"],
        messages: ["put", "delete", "query"], key_exprs: ["**/hexapod/**/cmd"] },
      { id: "answers out", permission: "allow", flows: ["egress"],
        messages: ["reply", "declare_subscriber", "declare_queryable"], key_exprs: ["**/hexapod/**/cmd"] },
      { id: "watching in", permission: "allow", flows: ["ingress"],
        messages: ["declare_subscriber"], key_exprs: ["**/hexapod/*"] },
      { id: "telemetry out", permission: "allow", flows: ["egress"],
        messages: ["put"], key_exprs: ["**/hexapod/state", "**/hexapod/event", "**/hexapod/frame"] },
      { id: "asking for the state in", permission: "allow", flows: ["ingress"],
        messages: ["query"], key_exprs: ["**/hexapod/state"] },
      { id: "state as an answer out", permission: "allow", flows: ["egress"],
        messages: ["reply", "declare_queryable"], key_exprs: ["**/hexapod/state"] },
      { id: "asking who is alive in", permission: "allow", flows: ["ingress"],
        messages: ["declare_liveliness_subscriber", "liveliness_query"], key_exprs: ["**/hexapod/alive"] },
      { id: "alive out", permission: "allow", flows: ["egress"],
        messages: ["liveliness_token"], key_exprs: ["**/hexapod/alive"] },
    ],
    subjects: [
      { id: "operator", cert_common_names: ["operator"] },
      { id: "observer", cert_common_names: ["observer"] },
    ],
    policies: [
      { subjects: ["operator"], rules: ["commands in", "answers out"] },
      { subjects: ["operator", "observer"],
        rules: ["watching in", "telemetry out", "asking for the state in", "state as an answer out",
                "asking who is alive in", "alive out"] },
    ],
  },
  // The gateway answers payloads over 4096 bytes with `too_large`; far larger ones are dropped before they reach it.
  low_pass_filter: [
    { id: "size", flows: ["ingress"], messages: ["put", "delete", "query", "reply"], key_exprs: ["**"],
      size_limit: @SIZE_LIMIT@ },
  ],
}
"""

_LAPTOP = """\
// @NAME@ as @ROLE@, made by `hexapod-gateway certs issue`.
//   hexapod-gateway watch --zenoh-config @NAME@.json5
// Paths are relative to this file's folder: keep ca.pem, @NAME@.pem and @NAME@.key beside it.
{
  mode: "client",@NAMESPACE@
  connect: {
    // Tried in turn until one answers; when the link breaks, again every 0.1 to 0.5 s.
    endpoints: @ENDPOINTS@,
    retry: { period_init_ms: 100, period_max_ms: 500, period_increase_factor: 1.5 },
  },
  scouting: { multicast: { enabled: false }, gossip: { enabled: false } },
  transport: {
    // By default a host that says nothing holds up the next one for 10 s.
    unicast: { open_timeout: 1000 },
    shared_memory: { enabled: false },
    link: {
      protocols: ["tls"],
      // The laptop's lease decides how soon a cut is noticed; with 1000 ms nothing that waited for 3 s comes out late.
      tx: { lease: 1000 },
      tls: {
        root_ca_certificate: "ca.pem",
        connect_certificate: "@NAME@.pem",
        connect_private_key: "@NAME@.key",
        enable_mtls: true,
        verify_name_on_connect: true,
      },
    },
  },
}
"""

_README = """\
The files of @NAME@, @ROLE@ of the hexapod at @HOSTS@. Valid until @EXPIRY@.

Unzip them anywhere, together, and keep @NAME@.key to yourself: whoever has it is @NAME@.

  hexapod-gateway watch --zenoh-config path/to/@NAME@.json5@COMMAND@

In Python:

  import zenoh
  from gateway.zenoh_config import load_client_config
  session = zenoh.open(load_client_config("path/to/@NAME@.json5"))

Other Zenoh programs read the paths in @NAME@.json5 from the folder they are started in: start them in this one.
"""


def gateway_json5(hosts: Sequence[str], port: int) -> bytes:
    """The robot's Zenoh configuration: mTLS on all addresses, access control by role, size limit, no scouting."""
    return _fill(_GATEWAY, HOSTS=", ".join(hosts), PORT=str(port), SIZE_LIMIT=str(SIZE_LIMIT))


def laptop_json5(name: str, role: str, hosts: Sequence[str], port: int, robot: str = "") -> bytes:
    """A laptop's Zenoh configuration: one endpoint for each host; `robot` is its robot in a fleet."""
    endpoints = json.dumps([endpoint(host, port) for host in hosts])
    namespace = f'\n  // Its keys on the router are {robot}/hexapod/…\n  namespace: "{robot}",' if robot else ""
    return _fill(_LAPTOP, NAME=name, ROLE=role, ENDPOINTS=endpoints, NAMESPACE=namespace)


def laptop_readme(name: str, role: str, hosts: Sequence[str], expiry: str) -> bytes:
    """What a bundle says to the person who unzips it."""
    command = f"\n  hexapod-gateway estop --zenoh-config path/to/{name}.json5" if role == "operator" else ""
    return _fill(_README, NAME=name, ROLE=role, HOSTS=" or ".join(hosts), EXPIRY=expiry, COMMAND=command)


def endpoint(host: str, port: int) -> str:
    """Zenoh's locator, an IPv6 address in brackets."""
    try:
        bracketed = f"[{host}]" if ipaddress.ip_address(host).version == 6 else host
    except ValueError:
        bracketed = host
    return f"tls/{bracketed}:{port}"


def _fill(template: str, **values: str) -> bytes:
    for key, value in values.items():
        template = template.replace(f"@{key}@", value)
    return template.encode()
