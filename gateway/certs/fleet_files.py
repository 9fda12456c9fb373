"""The Zenoh files of a fleet: router.json5 for the router that all robots dial, NAME.json5 for a robot's gateway.

Zenoh's access control compares a whole common name and cannot put it into a key expression, so the router's file has a
block for each robot, and is rewritten when a robot is added. Common names: `robot.NAME` of a robot's gateway,
`operator-07.NAME`, `observer-07.NAME` and `button-07.NAME` of its people, `gateway` of the routers; of people with
several robots, `operator-07.NAME.NAME` or `operator-07.robots.all` (pool.py). tests/zenoh/test_fleet.py runs gateways,
a router and people as separate processes.
"""

import json
from collections.abc import Container, Iterable, Sequence

from gateway.certs import BUTTON, LAPTOP_ROLES, OPERATOR, access, pool
from gateway.certs.zenoh_files import endpoint, fill

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
      // A client that does not read its replies loses its link after 20 ms. With Zenoh's own 5 s, one such laptop
      // delayed everything that the router receives, and all robots' links with it.
      tx: { lease: 1000, queue: { congestion_control: { block: { wait_before_close: 20000 } } } },
      // Limit in bytes of a message that is assembled from fragments.
      rx: { max_message_size: @MAX_MESSAGE_SIZE@ },
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

_POLICIES = """\
      { subjects: ["robot.@NAME@"],
        rules: @ROBOTS_RULES@ },
      { subjects: ["operator.@NAME@"],
        rules: @OPERATORS_RULES@ },
      { subjects: ["button.@NAME@"],
        rules: @BUTTONS_RULES@ },
      { subjects: ["operator.@NAME@", "observer.@NAME@", "button.@NAME@"],
        rules: @EVERYONES_RULES@ },
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
      rx: { max_message_size: @MAX_MESSAGE_SIZE@ },
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


def router_json5(
    robots: Sequence[str],
    port: int,
    numbers: Iterable[int] = range(pool.SIZE),
    revoked: Container[str] = (),
    groups: Iterable[str] = (),
) -> bytes:
    """The router's configuration: mTLS on all addresses, and a block of access control for each robot.

    `numbers`: of each role's pool of common names. `revoked`: common names to leave out. `groups`: of several robots,
    for which there are certificates; the group of all robots always has a pool.
    """
    groups = sorted({*groups, pool.ALL})
    return fill(
        _ROUTER,
        PORT=str(port),
        RULES="".join(map(_rules, robots)),
        SUBJECTS="".join(_subjects(robot, numbers, revoked, groups) for robot in robots),
        POLICIES="".join(map(_policies, robots)),
    )


def robot_json5(name: str, host: str, port: int) -> bytes:
    """A gateway's configuration: it dials the router and listens on nothing."""
    return fill(_ROBOT, NAME=name, ENDPOINTS=json.dumps([endpoint(host, port)]))


def _rules(robot: str) -> str:
    """The rules for the people's and the robot's side of the same traffic."""
    peoples, robots = access.rules(f"{robot}: ", robot), access.rules(f"{robot}'s end: ", robot, robots_side=True)
    return f"      // ---- {robot}\n{peoples}{robots}"


def _subjects(robot: str, numbers: Iterable[int], revoked: Container[str], groups: Sequence[str]) -> str:
    """The subjects of a robot. If all names of a role are revoked, a placeholder: none would match everyone."""
    subjects = access.subject(f"robot.{robot}", [f"robot.{robot}"])
    for role in LAPTOP_ROLES:
        of = [robot, *(group for group in groups if pool.Holder(role, None, group).is_for(robot))]
        named = [name for group in of for name in pool.names(role, numbers, group) if name not in revoked]
        subjects += access.subject(f"{role}.{robot}", named or [pool.NO_COMMON_NAME])
    return subjects


def _policies(robot: str) -> str:
    prefix = f"{robot}: "
    return fill(
        _POLICIES,
        NAME=robot,
        ROBOTS_RULES=access.robots_names(f"{robot}'s end: "),
        OPERATORS_RULES=access.names(prefix, roles=(OPERATOR,)),
        BUTTONS_RULES=access.names(prefix, roles=(BUTTON,)),
        EVERYONES_RULES=access.names(prefix, roles=LAPTOP_ROLES),
    ).decode()
