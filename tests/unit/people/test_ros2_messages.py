"""ROS 2's messages as bytes: compared with rosbags, with what CycloneDDS wrote, and with what ends early or lies."""

import math
import struct
import tracemalloc
from contextlib import suppress
from typing import Any, Final

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.people.ros2 import actions, messages
from gateway.people.ros2.actions import (
    CANCEL_GOAL,
    GET_RESULT,
    SEND_GOAL,
    CancelGoalResponse,
    FollowFeedbackMessage,
)
from gateway.people.ros2.cdr import CdrError, Message, decode, definition, encode, ros_msg
from gateway.people.ros2.messages import (
    TRIGGER_HASH,
    DiagnosticArray,
    Duration,
    Header,
    ImuMessage,
    JointState,
    JointTrajectory,
    JointTrajectoryPoint,
    Log,
    String,
    TFMessage,
    Time,
    TriggerRequest,
    TriggerResponse,
    Twist,
    TwistStamped,
)
from tests.support import ros2_messages

TYPES: Final[list[type[Message]]] = [
    kind
    for kind in (vars(messages) | vars(actions)).values()
    if isinstance(kind, type) and issubclass(kind, Message) and kind != Message
]
STORE: Final = ros2_messages.store_of("jazzy")

HASHES: Final = {
    JointState.HASH: "a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e",
    DiagnosticArray.HASH: "5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e",
    JointTrajectory.HASH: "179b33eba59d676f6d967ac71fe35e7ca2f64b2f3928f4a018cec115e213796e",
    Twist.HASH: "9c45bf16fe0983d80e3cfe750d6835843d265a9a6c46bd2e609fcddde6fb8d2a",
    TwistStamped.HASH: "5f0fcd4f81d5d06ad9b4c4c63e3ea51b82d6ae4d0558f1d475229b1121db6f64",
    TFMessage.HASH: "e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087",
    String.HASH: "df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18",
    TRIGGER_HASH: "eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f",
}
"""As rmw_zenoh_cpp and other implementations publish them."""
GENERATED: Final = {
    FollowFeedbackMessage.HASH: "80398fcb9674a79081a9906e2ccf0c804dd7cb15e22e362e606ee87186beab71",
    SEND_GOAL[1]: "b13789dddc325a7a962825c45e28c77d37237ec129dd0c34dc5994562938c57f",
    GET_RESULT[1]: "e3ceb38e3e1867c8dc0f46014df26e90eb93422f27e9e97f936e07f94be4bc8b",
    CANCEL_GOAL[1]: "573d8b0a534451d7bc2ac8c5ffde8ac14b8593b7001175d0cd6516dcbeb8689a",
}
"""As ROS 2's own `rosidl_generator_type_description` 4.9.5 computes them from the same definitions."""

_HEADER: Final = Header(Time(1, 2), "base_link")
CYCLONE: Final = (
    (
        JointState(_HEADER, ("joint_11", "j"), (0.5, -1.25), (), (3.0,)),
        "0001000001000000020000000a000000626173655f6c696e6b00000002000000090000006a6f696e745f313100000000020000006a00000002"
        "000000000000000000e03f000000000000f4bf00000000010000000000000000000840",
    ),
    (JointState(), "000100000000000000000000010000000000000000000000000000000000000000000000"),
    (
        JointTrajectory(
            _HEADER,
            ("joint_11",),
            (
                JointTrajectoryPoint((0.5,), time_from_start=Duration(0, 5)),
                JointTrajectoryPoint((1.5,), (0.25,), time_from_start=Duration(-1, 999_999_999)),
            ),
        ),
        "0001000001000000020000000a000000626173655f6c696e6b00000001000000090000006a6f696e745f31310000000002000000010000000000"
        "0000000000000000e03f000000000000000000000000000000000500000001000000000000000000f83f0100000000000000000000000000d03f"
        "0000000000000000ffffffffffc99a3b",
    ),
)
"""Written by `cyclonedds` 11.0.1, which builds where there is no wheel, and so is not asked each time."""

_VALUES: Final[dict[str, st.SearchStrategy[Any]]] = {
    "bool": st.booleans(),
    "byte": st.integers(0, 127),  # which rosbags takes for signed
    "int8": st.integers(-128, 127),
    "uint8": st.integers(0, 255),
    "uint16": st.integers(0, 65535),
    "int32": st.integers(-(2**31), 2**31 - 1),
    "uint32": st.integers(0, 2**32 - 1),
    "float32": st.floats(allow_nan=False, width=32),
    "float64": st.floats(allow_nan=False),
    "string": st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=6),
}


def values(kind: type[Message]) -> st.SearchStrategy[Any]:
    """Messages of a type with anything in them."""
    fields = {
        name: (st.lists(one, min_size=count or 0, max_size=count or 3).map(tuple) if many else one)
        for name, element, many, count in kind.FIELDS
        for one in [_VALUES[element] if isinstance(element, str) else values(element)]
    }
    return st.builds(kind, **fields)


def rosbags_message(message: Message) -> Any:
    """The same message of rosbags' own classes."""
    fields: dict[str, Any] = {}
    for name, element, many, _ in message.FIELDS:
        value: Any = getattr(message, name)
        if many and element in ("float32", "float64", "uint8"):
            fields[name] = np.array(value, dtype=str(element))
        elif isinstance(element, str):
            fields[name] = list(value) if many else value
        else:
            fields[name] = [rosbags_message(each) for each in value] if many else rosbags_message(value)
    return STORE.types[message.TYPE](**fields)


IN_ROSBAGS: Final = [kind for kind in TYPES if kind.TYPE in STORE.types]
any_message = st.sampled_from(IN_ROSBAGS).flatmap(values)


def test_the_modules_are_what_the_generator_writes() -> None:
    for path, text in ros2_messages.texts().items():
        assert path.read_text() == text


@pytest.mark.parametrize("hashes", [HASHES, GENERATED], ids=["published", "generated"])
def test_hashes_are_those_of_other_implementations(hashes: dict[str, str]) -> None:
    assert list(hashes) == [f"RIHS01_{digest}" for digest in hashes.values()]


NESTS_NO_ACTION: Final = [kind for kind in IN_ROSBAGS if "/action/" not in definition(kind)]
"""rosbags writes no definition with a type of an action in it."""


@pytest.mark.parametrize("kind", NESTS_NO_ACTION, ids=lambda kind: kind.__name__)
def test_definitions_are_those_of_rosbags(kind: type[Message]) -> None:
    assert definition(kind) == STORE.generate_msgdef(kind.TYPE, ros_version=2)[0]


@given(any_message)
def test_rosbags_writes_the_same_bytes(message: Message) -> None:
    data = encode(message)
    assert data == bytes(STORE.serialize_cdr(rosbags_message(message), message.TYPE, little_endian=True))
    assert decode(type(message), data) == message


@given(any_message)
def test_bytes_of_a_big_endian_machine_are_read(message: Message) -> None:
    data = bytes(STORE.serialize_cdr(rosbags_message(message), message.TYPE, little_endian=False))
    assert decode(type(message), data) == message


@pytest.mark.parametrize(("message", "expected"), CYCLONE, ids=["joints", "empty", "trajectory"])
def test_cyclonedds_writes_the_same_bytes(message: Message, expected: str) -> None:
    assert encode(message).hex() == expected
    assert decode(type(message), bytes.fromhex(expected)) == message


def test_an_empty_message_is_one_byte_which_some_leave_out() -> None:
    assert encode(TriggerRequest()) == b"\x00\x01\x00\x00\x00"
    assert decode(TriggerRequest, b"\x00\x01\x00\x00") == TriggerRequest()
    assert decode(TriggerRequest, b"\x00\x01\x00\x00\x00") == TriggerRequest()


@pytest.mark.parametrize(
    "message", [each for each, _ in CYCLONE] + [TriggerResponse(True, "on"), Log(msg="hm"), CancelGoalResponse(-1)]
)
def test_what_ends_early_is_no_message(message: Message) -> None:
    data = encode(message)
    for length in range(len(data)):
        with pytest.raises(CdrError):
            decode(type(message), data[:length])


@pytest.mark.parametrize("behind", [b"\0", bytes(8), b"\xff" * 8, b"x" * 4000], ids=len)
def test_bytes_behind_the_last_field_mean_nothing(behind: bytes) -> None:
    """As `rmw_serialize` writes them, and so C++'s SerializedMessage, and bags that are played."""
    data = encode(String("a"))
    assert decode(String, data + behind) == String("a")


@given(st.sampled_from(TYPES), st.binary(max_size=200), st.booleans())
def test_any_bytes_are_a_message_or_a_cdr_error(kind: type[Message], body: bytes, is_framed: bool) -> None:
    with suppress(CdrError):
        assert isinstance(decode(kind, b"\x00\x01\x00\x00" + body if is_framed else body), kind)


def test_a_count_that_lies_takes_no_memory() -> None:
    head = encode(Header())
    tracemalloc.start()
    for count in (2**32 - 1, 1_000_000):
        with pytest.raises(CdrError):
            decode(JointState, head + bytes(-len(head) % 4) + struct.pack("<I", count))
    assert tracemalloc.get_traced_memory()[1] < 100_000
    tracemalloc.stop()


@ros_msg("test_msgs/msg/Empties", "")
class Empties(Message):
    """No type here has such a sequence: each element is one byte, or none."""

    all: tuple[TriggerRequest, ...]


def test_a_count_of_nothings_that_lies_takes_no_time() -> None:
    with pytest.raises(CdrError, match="4294967295 elements in 0 bytes"):
        decode(Empties, b"\x00\x01\x00\x00\xff\xff\xff\xff")


def test_what_cannot_be_written_is_reported() -> None:
    short = ImuMessage(orientation_covariance=(0.0,) * 8)
    for message in (String("a\0b"), String("\ud800"), Time(2**31, 0), Duration(0, -1), short):
        with pytest.raises(CdrError):
            encode(message)


def test_not_a_number_is_a_number_of_cdr() -> None:
    (position,) = decode(JointState, encode(JointState(position=(float("nan"),)))).position
    assert math.isnan(position)
