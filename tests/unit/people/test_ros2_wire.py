"""Keys, tokens and attachments, compared with those of a library that is not ours, and with rmw_zenoh's own words."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from zenoh_ros2_sdk import attachment as their_attachment
from zenoh_ros2_sdk import keyexpr
from zenoh_ros2_sdk.entity import EndpointEntity, EntityKind, NodeEntity
from zenoh_ros2_sdk.qos import QosDurability, QosProfile, QosReliability

from gateway.people.ros2.messages import JointState, String
from gateway.people.ros2.wire import (
    NO_HASH,
    PUBLISHES,
    QOS,
    QOS_LATCHED,
    Attachment,
    Names,
    WireError,
    gid_of,
)

NAMES = Names(0, "/hexapod", "hexapod_gateway", hashes=True)
ZID = "aac3178e146ba6f1fc6e6a4085e77f21"


@pytest.mark.parametrize("namespace", ["/", "/hexapod", "/fleet/robot_1"])
def test_keys_and_tokens_are_those_of_another_implementation(namespace: str) -> None:
    names = Names(7, namespace, "hexapod_gateway", hashes=True)
    topic = names.full("joint_states")
    node = NodeEntity(7, ZID, 0, "hexapod_gateway", namespace)
    dds = "sensor_msgs::msg::dds_::JointState_"
    end = EndpointEntity(node, 3, EntityKind.PUBLISHER, topic, dds, JointState.HASH, QOS)
    assert names.topic_key("joint_states", JointState) == keyexpr.topic_keyexpr(7, topic, dds, JointState.HASH)
    assert names.node_token(ZID) == keyexpr.node_liveliness_keyexpr(node)
    shown = names.token(ZID, 3, PUBLISHES, "joint_states", JointState.TYPE, JointState.HASH, QOS)
    assert shown == keyexpr.endpoint_liveliness_keyexpr(end)


def test_keys_as_rmw_zenoh_documents_them() -> None:
    names = Names(0, "/", "talker", hashes=True)
    assert names.topic_key("chatter", String) == (
        "0/chatter/std_msgs::msg::dds_::String_/RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
    )
    assert names.node_token(ZID) == f"@ros2_lv/0/{ZID}/0/0/NN/%/%/talker"


def test_humble_has_a_word_in_place_of_hashes() -> None:
    names = Names(0, "/hexapod", "hexapod_gateway", hashes=False)
    assert names.topic_key("joint_states", JointState).endswith(f"/{NO_HASH}")
    assert f"/{NO_HASH}/" in names.token(ZID, 1, PUBLISHES, "joint_states", JointState.TYPE, JointState.HASH, QOS)


def test_quality_of_service_is_read_as_it_is_meant() -> None:
    usual, latched = QosProfile.decode(QOS), QosProfile.decode(QOS_LATCHED)
    assert (usual.durability, usual.history_depth) == (QosDurability.VOLATILE, 10)
    assert (latched.durability, latched.history_depth) == (QosDurability.TRANSIENT_LOCAL, 1)
    assert usual.reliability == latched.reliability == QosReliability.RELIABLE


@pytest.mark.parametrize("namespace", ["", "hexapod", "/hexapod/", "//a", "/1a", "/a-b", "/*", "/a/**", "/ż"])
def test_what_is_no_namespace(namespace: str) -> None:
    with pytest.raises(WireError, match="no ROS namespace"):
        Names(0, namespace, "hexapod_gateway", hashes=True)


@given(st.integers(0, 2**63 - 1), st.integers(0, 2**63 - 1), st.binary(min_size=16, max_size=16))
def test_attachments_are_those_of_another_implementation(number: int, time_ns: int, gid: bytes) -> None:
    ours = Attachment(number, time_ns, gid)
    assert ours.to_bytes() == their_attachment.Attachment(number, time_ns, gid).to_bytes()
    assert Attachment.from_bytes(ours.to_bytes()) == ours


@pytest.mark.parametrize(
    ("data", "why"),
    [
        (None, "no attachment"),
        (b"", "0 bytes"),
        (bytes(32), "32 bytes"),
        (bytes(34), "34 bytes"),
        (bytes(33), "GID has 0 bytes"),
        (b"\xff" * 33, "GID has 255 bytes"),
    ],
)
def test_what_is_no_attachment(data: bytes | None, why: str) -> None:
    with pytest.raises(WireError, match=why):
        Attachment.from_bytes(data)


def test_gid() -> None:
    """XXH3-128 of the empty string is 99aa06d3014798d86001c324468d497f, by its specification."""
    assert gid_of("").hex() == "7f498d4624c30160d8984701d306aa99"
