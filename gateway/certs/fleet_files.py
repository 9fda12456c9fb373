"""The Zenoh files of a fleet: router.json5 for the router all robots dial, NAME.json5 for a robot's gateway.

Zenoh's access control compares a certificate's common name whole and cannot put it into a key expression, so the
router's file has one block for each robot, and is made anew when a robot is added. Who is whom: `robot.NAME` the
gateway of a robot, `operator.NAME` and `observer.NAME` its people, `gateway` the routers themselves.
tests/test_fleet.py has the gateways, a router and people as processes of their own.
"""

import json
from collections.abc import Sequence

from gateway.certs.zenoh_files import SIZE_LIMIT, endpoint

_ROUTER = """\
// The router of a fleet, made by `hexapod-gateway certs robot`, which makes it anew for each robot that is added.
//   zenohd -c router.json5        (in this file's folder, with ca.pem, gateway.pem and gateway.key beside it)
{
  mode: "router",
  // All addresses, IPv4 and IPv6. On a kernel without IPv6: tls/0.0.0.0:@PORT@
  listen: { endpoints: ["tls/[::]:@PORT@"] },
  // Other routers to federate with, such as tls/router-2.local:7447.
  connect: { endpoints: [] },
  scouting: { multicast: { enabled: false }, gossip: { enabled: false } },
  adminspace: { enabled: false },
  transport: {
    // Shared memory would go around the size limit.
    shared_memory: { enabled: false },
    link: {
      protocols: ["tls"],
      // Who asks and does not read loses the link after 20 ms. With Zenoh's own 5 s, one such laptop held up everything
      // that the router receives, and all robots' links with it.
      tx: { lease: 1000, queue: { congestion_control: { block: { wait_before_close: 20000 } } } },
      tls: {
        root_ca_certificate: "ca.pem",
        listen_certificate: "gateway.pem",
        listen_private_key: "gateway.key",
        connect_certificate: "gateway.pem",
        connect_private_key: "gateway.key",
        enable_mtls: true,
        verify_name_on_connect: true,
        close_link_on_expiration: true,
      },
    },
  },
  // What is not allowed here is dropped: a robot speaks and listens under its own name only, and so do its people.
  access_control: {
    enabled: true,
    default_permission: "deny",
    rules: [
      { id: "between routers", permission: "allow", flows: ["ingress", "egress"],
        messages: ["put", "delete", "query", "reply", "declare_subscriber", "declare_queryable", "liveliness_token",
                   "declare_liveliness_subscriber", "liveliness_query"],
        key_exprs: ["**"] },
@RULES@    ],
    subjects: [
      { id: "routers", cert_common_names: ["gateway"] },
@SUBJECTS@    ],
    policies: [
      { subjects: ["routers"], rules: ["between routers"] },
@POLICIES@    ],
  },
  low_pass_filter: [
    { id: "size", flows: ["ingress"], messages: ["put", "delete", "query", "reply"], key_exprs: ["**"],
      size_limit: @SIZE_LIMIT@ },
  ],
}
"""

# People's side and the robot's side of the same traffic: what comes in at one goes out at the other.
_RULES = """\
      // ---- @NAME@
      { id: "@NAME@: commands from people", permission: "allow", flows: ["ingress"],
        messages: ["put", "delete", "query"], key_exprs: ["@NAME@/hexapod/**/cmd"] },
      { id: "@NAME@: answers to people", permission: "allow", flows: ["egress"],
        messages: ["reply", "declare_subscriber", "declare_queryable"], key_exprs: ["@NAME@/hexapod/**/cmd"] },
      { id: "@NAME@: people ask", permission: "allow", flows: ["ingress"],
        messages: ["declare_subscriber", "query", "declare_liveliness_subscriber", "liveliness_query"],
        key_exprs: ["@NAME@/hexapod/*"] },
      { id: "@NAME@: people see", permission: "allow", flows: ["egress"],
        messages: ["put", "reply", "declare_queryable", "liveliness_token"], key_exprs: ["@NAME@/hexapod/*"] },
      { id: "@NAME@: commands to the robot", permission: "allow", flows: ["egress"],
        messages: ["put", "delete", "query"], key_exprs: ["@NAME@/hexapod/**/cmd"] },
      { id: "@NAME@: answers of the robot", permission: "allow", flows: ["ingress"],
        messages: ["reply", "declare_subscriber", "declare_queryable"], key_exprs: ["@NAME@/hexapod/**/cmd"] },
      { id: "@NAME@: the robot is asked", permission: "allow", flows: ["egress"],
        messages: ["declare_subscriber", "query", "declare_liveliness_subscriber", "liveliness_query"],
        key_exprs: ["@NAME@/hexapod/*"] },
      { id: "@NAME@: the robot tells", permission: "allow", flows: ["ingress"],
        messages: ["put", "reply", "declare_queryable", "liveliness_token"], key_exprs: ["@NAME@/hexapod/*"] },
"""

_SUBJECTS = """\
      { id: "robot.@NAME@", cert_common_names: ["robot.@NAME@"] },
      { id: "operator.@NAME@", cert_common_names: ["operator.@NAME@"] },
      { id: "observer.@NAME@", cert_common_names: ["observer.@NAME@"] },
"""

_POLICIES = """\
      { subjects: ["robot.@NAME@"],
        rules: ["@NAME@: commands to the robot", "@NAME@: answers of the robot", "@NAME@: the robot is asked",
                "@NAME@: the robot tells"] },
      { subjects: ["operator.@NAME@"],
        rules: ["@NAME@: commands from people", "@NAME@: answers to people"] },
      { subjects: ["operator.@NAME@", "observer.@NAME@"],
        rules: ["@NAME@: people ask", "@NAME@: people see"] },
"""

_ROBOT = """\
// The gateway of @NAME@ in a fleet, made by `hexapod-gateway certs robot`. In gateway.toml:
//   [zenoh]
//   listen = []
//   config = "/etc/hexapod-gateway/zenoh/@NAME@.json5"
// Paths are relative to this file's folder: keep ca.pem, @NAME@.pem and @NAME@.key beside it.
{
  mode: "peer",
  // On the router its keys are @NAME@/hexapod/…; here and to its people they stay hexapod/…
  namespace: "@NAME@",
  // Nobody dials the robot; it dials the router, and again every 0.1 to 1 s when that is away. One endpoint only: a
  // peer dials all of them, and with two routers at once every command came twice. (A client would dial one after the
  // other, but does not start while none answers.)
  listen: { endpoints: [] },
  connect: {
    endpoints: @ENDPOINTS@,
    retry: { period_init_ms: 100, period_max_ms: 1000, period_increase_factor: 1.5 },
  },
  scouting: { multicast: { enabled: false }, gossip: { enabled: false } },
  adminspace: { enabled: false },
  transport: {
    unicast: { open_timeout: 1000 },
    shared_memory: { enabled: false },
    link: {
      protocols: ["tls"],
      tx: { lease: 1000 },
      tls: {
        root_ca_certificate: "ca.pem",
        connect_certificate: "@NAME@.pem",
        connect_private_key: "@NAME@.key",
        enable_mtls: true,
        verify_name_on_connect: true,
        close_link_on_expiration: true,
      },
    },
  },
  low_pass_filter: [
    { id: "size", flows: ["ingress"], messages: ["put", "delete", "query", "reply"], key_exprs: ["**"],
      size_limit: @SIZE_LIMIT@ },
  ],
}
"""


def router_json5(robots: Sequence[str], port: int) -> bytes:
    """The router's configuration: mTLS on all addresses, and one block of access control for each robot."""

    def each(block: str) -> str:
        return "".join(block.replace("@NAME@", robot) for robot in robots)

    text = _ROUTER.replace("@PORT@", str(port)).replace("@SIZE_LIMIT@", str(SIZE_LIMIT))
    text = text.replace("@RULES@", each(_RULES)).replace("@SUBJECTS@", each(_SUBJECTS))
    return text.replace("@POLICIES@", each(_POLICIES)).encode()


def robot_json5(name: str, host: str, port: int) -> bytes:
    """A gateway's configuration: it dials the router and listens on nothing."""
    endpoints = json.dumps([endpoint(host, port)])
    text = _ROBOT.replace("@NAME@", name).replace("@ENDPOINTS@", endpoints)
    return text.replace("@SIZE_LIMIT@", str(SIZE_LIMIT)).encode()
