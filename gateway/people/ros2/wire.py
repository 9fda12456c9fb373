"""How ROS 2 travels over Zenoh (rmw_zenoh 0.2.4 and later): keys, attachments, and the tokens that make a node seen."""

import re
import struct
from dataclasses import dataclass
from typing import Final, NamedTuple, Self

import xxhash

from gateway.people.ros2.cdr import Message

NO_HASH: Final = "TypeHashNotSupported"
"""What Humble writes in place of a hash."""
GRAPH: Final = "@ros2_lv"
PUBLISHES: Final = "MP"
SUBSCRIBES: Final = "MS"
SERVES: Final = "SS"
CALLS: Final = "SC"
_NODE: Final = "NN"

QOS: Final = "::,10:,:,:,,"
"""Reliable, volatile, the last ten: what `create_publisher(…, 10)` has."""
QOS_LATCHED: Final = ":1:,1:,:,:,,"
"""Reliable, transient local, the last one."""

_NAMESPACE: Final = re.compile(r"/|(/[A-Za-z_]\w*)+", re.ASCII)
_ATTACHMENT: Final = struct.Struct("<qqB16s")
_GID_BYTES: Final = 16


class WireError(ValueError):
    """What came is not as rmw_zenoh sends it; one sentence."""


class Attachment(NamedTuple):
    """What rmw_zenoh sends with each message, request and response."""

    number: int
    """Of the message, by its publisher: 1 is the first. A response repeats its request's."""
    time_ns: int
    """By the publisher's clock, since 1970."""
    gid: bytes
    """16 bytes: the publisher; in a response, the client that asked."""

    def to_bytes(self) -> bytes:
        """Write the attachment's 33 bytes."""
        return _ATTACHMENT.pack(self.number, self.time_ns, _GID_BYTES, self.gid)

    @classmethod
    def from_bytes(cls, data: bytes | None) -> Self:
        """Read an attachment. Raises WireError."""
        if data is None:
            raise WireError("it has no attachment, so it is not from rmw_zenoh")
        if len(data) != _ATTACHMENT.size:
            raise WireError(f"its attachment has {len(data)} bytes, and rmw_zenoh's has {_ATTACHMENT.size}")
        number, time_ns, length, gid = _ATTACHMENT.unpack(data)
        if length != _GID_BYTES:
            raise WireError(f"its attachment's GID has {length} bytes in place of {_GID_BYTES}")
        return cls(number, time_ns, gid)


def gid_of(token: str) -> bytes:
    """The GID of the program that declares this token."""
    return xxhash.xxh3_128_digest(token.encode())[::-1]


def dds_type(type_name: str) -> str:
    """`std_msgs/msg/String` → `std_msgs::msg::dds_::String_`."""
    package, kind, name = type_name.split("/")
    return f"{package}::{kind}::dds_::{name}_"


@dataclass(frozen=True)
class Names:
    """The names of one node's topics and services, and their keys."""

    domain: int
    namespace: str
    """`/hexapod`, or `/`. Raises WireError for one that ROS 2 does not know."""
    node: str
    hashes: bool
    """Whether the distribution has hashes; Humble has none."""

    def __post_init__(self) -> None:
        if not _NAMESPACE.fullmatch(self.namespace):
            raise WireError(f"{self.namespace!r} is no ROS namespace, such as /hexapod, or / for none")

    def full(self, name: str) -> str:
        """`cmd_vel` → `/hexapod/cmd_vel`; what begins with a slash stays."""
        return name if name.startswith("/") else f"{self.namespace.rstrip('/')}/{name}"

    def key(self, name: str, type_name: str, type_hash: str) -> str:
        """Where messages of a topic, or requests of a service, are put."""
        return f"{self.domain}{self.full(name)}/{dds_type(type_name)}/{self.shown_hash(type_hash)}"

    def topic_key(self, name: str, kind: type[Message]) -> str:
        """Where messages of this topic are put."""
        return self.key(name, kind.TYPE, kind.HASH)

    def any_type(self, name: str) -> str:
        """All keys of a topic or service, whichever type and hash its peers take it for."""
        return f"{self.domain}{self.full(name)}/*/*"

    def shown_hash(self, type_hash: str) -> str:
        """As this distribution writes it."""
        return type_hash if self.hashes else NO_HASH

    def node_token(self, zid: str) -> str:
        """By which the graph shows the node."""
        return f"{GRAPH}/{self.domain}/{zid}/0/0/{_NODE}/%/{_mangled(self.namespace)}/{self.node}"

    def token(self, zid: str, number: int, kind: str, name: str, type_name: str, type_hash: str, qos: str) -> str:
        """By which the graph shows a publisher, subscriber or service; `number` is its own in the session."""
        return (
            f"{GRAPH}/{self.domain}/{zid}/0/{number}/{kind}/%/{_mangled(self.namespace)}/{self.node}/"
            f"{_mangled(self.full(name))}/{dds_type(type_name)}/{self.shown_hash(type_hash)}/{qos}"
        )

    def tokens(self, kind: str, name: str) -> str:
        """The tokens of all who publish on a topic (`PUBLISHES`), or call a service (`CALLS`)."""
        return f"{GRAPH}/{self.domain}/*/*/*/{kind}/*/*/*/{_mangled(self.full(name))}/**"


def _mangled(name: str) -> str:
    return "%" if name == "/" else name.replace("/", "%")
