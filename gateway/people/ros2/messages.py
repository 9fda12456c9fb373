"""ROS 2's message types, written by `python -m tests.support.ros2_messages`: do not edit.

They are the same in all of `DISTRIBUTIONS` (rosbags keeps their definitions). Fields are documented where ROS 2 is.
"""

from dataclasses import dataclass
from typing import ClassVar, Final

from gateway.people.ros2.cdr import Message, byte, float32, float64, int32, uint8, uint32

DISTRIBUTIONS: Final = ("humble", "jazzy", "kilted", "lyrical")

TRIGGER_TYPE: Final = "std_srvs/srv/Trigger"
TRIGGER_HASH: Final = "RIHS01_eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f"
"""Of the service; its request and response have hashes of their own, which nothing on the wire shows."""


@dataclass(frozen=True, slots=True)
class String(Message):
    TYPE: ClassVar[str] = "std_msgs/msg/String"
    HASH: ClassVar[str] = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"

    data: str = ""


@dataclass(frozen=True, slots=True)
class Int32(Message):
    TYPE: ClassVar[str] = "std_msgs/msg/Int32"
    HASH: ClassVar[str] = "RIHS01_b6578ded3c58c626cfe8d1a6fb6e04f706f97e9f03d2727c9ff4e74b1cef0deb"

    data: int32 = 0


@dataclass(frozen=True, slots=True)
class Float64(Message):
    TYPE: ClassVar[str] = "std_msgs/msg/Float64"
    HASH: ClassVar[str] = "RIHS01_705ba9c3d1a09df43737eb67095534de36fd426c0587779bda2bc51fe790182a"

    data: float64 = 0.0


@dataclass(frozen=True, slots=True)
class Time(Message):
    TYPE: ClassVar[str] = "builtin_interfaces/msg/Time"
    HASH: ClassVar[str] = "RIHS01_b106235e25a4c5ed35098aa0a61a3ee9c9b18d197f398b0e4206cea9acf9c197"

    sec: int32 = 0
    nanosec: uint32 = 0


@dataclass(frozen=True, slots=True)
class Header(Message):
    TYPE: ClassVar[str] = "std_msgs/msg/Header"
    HASH: ClassVar[str] = "RIHS01_f49fb3ae2cf070f793645ff749683ac6b06203e41c891e17701b1cb597ce6a01"

    stamp: Time = Time()
    frame_id: str = ""


@dataclass(frozen=True, slots=True)
class JointState(Message):
    TYPE: ClassVar[str] = "sensor_msgs/msg/JointState"
    HASH: ClassVar[str] = "RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e"

    header: Header = Header()
    name: tuple[str, ...] = ()
    position: tuple[float64, ...] = ()
    velocity: tuple[float64, ...] = ()
    effort: tuple[float64, ...] = ()


@dataclass(frozen=True, slots=True)
class KeyValue(Message):
    TYPE: ClassVar[str] = "diagnostic_msgs/msg/KeyValue"
    HASH: ClassVar[str] = "RIHS01_d68081eaa540288c5440753baecef0c4e16e81a5f78ad68902ded5100413bb42"

    key: str = ""
    value: str = ""


@dataclass(frozen=True, slots=True)
class DiagnosticStatus(Message):
    TYPE: ClassVar[str] = "diagnostic_msgs/msg/DiagnosticStatus"
    HASH: ClassVar[str] = "RIHS01_b0e3e692ea2d54a8af2f4ef1930e81556a2db55216b771f8a7d2724ed47bf0e4"
    OK: ClassVar[byte] = 0
    WARN: ClassVar[byte] = 1
    ERROR: ClassVar[byte] = 2
    STALE: ClassVar[byte] = 3

    level: byte = 0
    name: str = ""
    message: str = ""
    hardware_id: str = ""
    values: tuple[KeyValue, ...] = ()


@dataclass(frozen=True, slots=True)
class DiagnosticArray(Message):
    TYPE: ClassVar[str] = "diagnostic_msgs/msg/DiagnosticArray"
    HASH: ClassVar[str] = "RIHS01_5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e"

    header: Header = Header()
    status: tuple[DiagnosticStatus, ...] = ()


@dataclass(frozen=True, slots=True)
class Vector3(Message):
    TYPE: ClassVar[str] = "geometry_msgs/msg/Vector3"
    HASH: ClassVar[str] = "RIHS01_cc12fe83e4c02719f1ce8070bfd14aecd40f75a96696a67a2a1f37f7dbb0765d"

    x: float64 = 0.0
    y: float64 = 0.0
    z: float64 = 0.0


@dataclass(frozen=True, slots=True)
class Twist(Message):
    TYPE: ClassVar[str] = "geometry_msgs/msg/Twist"
    HASH: ClassVar[str] = "RIHS01_9c45bf16fe0983d80e3cfe750d6835843d265a9a6c46bd2e609fcddde6fb8d2a"

    linear: Vector3 = Vector3()
    angular: Vector3 = Vector3()


@dataclass(frozen=True, slots=True)
class TwistStamped(Message):
    TYPE: ClassVar[str] = "geometry_msgs/msg/TwistStamped"
    HASH: ClassVar[str] = "RIHS01_5f0fcd4f81d5d06ad9b4c4c63e3ea51b82d6ae4d0558f1d475229b1121db6f64"

    header: Header = Header()
    twist: Twist = Twist()


@dataclass(frozen=True, slots=True)
class Quaternion(Message):
    TYPE: ClassVar[str] = "geometry_msgs/msg/Quaternion"
    HASH: ClassVar[str] = "RIHS01_8a765f66778c8ff7c8ab94afcc590a2ed5325a1d9a076ffff38fbce36f458684"

    x: float64 = 0.0
    y: float64 = 0.0
    z: float64 = 0.0
    w: float64 = 0.0


@dataclass(frozen=True, slots=True)
class Transform(Message):
    TYPE: ClassVar[str] = "geometry_msgs/msg/Transform"
    HASH: ClassVar[str] = "RIHS01_beb83fbe698636351461f6f35d1abb20010c43d55374d81bd041f1ba2581fddc"

    translation: Vector3 = Vector3()
    rotation: Quaternion = Quaternion()


@dataclass(frozen=True, slots=True)
class TransformStamped(Message):
    TYPE: ClassVar[str] = "geometry_msgs/msg/TransformStamped"
    HASH: ClassVar[str] = "RIHS01_0a241f87d04668d94099cbb5ba11691d5ad32c2f29682e4eb5653424bd275206"

    header: Header = Header()
    child_frame_id: str = ""
    transform: Transform = Transform()


@dataclass(frozen=True, slots=True)
class TFMessage(Message):
    TYPE: ClassVar[str] = "tf2_msgs/msg/TFMessage"
    HASH: ClassVar[str] = "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087"

    transforms: tuple[TransformStamped, ...] = ()


@dataclass(frozen=True, slots=True)
class Duration(Message):
    TYPE: ClassVar[str] = "builtin_interfaces/msg/Duration"
    HASH: ClassVar[str] = "RIHS01_e8d009f659816f758b75334ee1a9ca5b5c0b859843261f14c7f937349599d93b"

    sec: int32 = 0
    nanosec: uint32 = 0


@dataclass(frozen=True, slots=True)
class JointTrajectoryPoint(Message):
    TYPE: ClassVar[str] = "trajectory_msgs/msg/JointTrajectoryPoint"
    HASH: ClassVar[str] = "RIHS01_de8907036d8bd45aac6f30cc9044a3d4a329c42cbf719aff7d95a584cfa532d7"

    positions: tuple[float64, ...] = ()
    velocities: tuple[float64, ...] = ()
    accelerations: tuple[float64, ...] = ()
    effort: tuple[float64, ...] = ()
    time_from_start: Duration = Duration()


@dataclass(frozen=True, slots=True)
class JointTrajectory(Message):
    TYPE: ClassVar[str] = "trajectory_msgs/msg/JointTrajectory"
    HASH: ClassVar[str] = "RIHS01_179b33eba59d676f6d967ac71fe35e7ca2f64b2f3928f4a018cec115e213796e"

    header: Header = Header()
    joint_names: tuple[str, ...] = ()
    points: tuple[JointTrajectoryPoint, ...] = ()


@dataclass(frozen=True, slots=True)
class Log(Message):
    TYPE: ClassVar[str] = "rcl_interfaces/msg/Log"
    HASH: ClassVar[str] = "RIHS01_e28ce254ca8abc06abf92773b74602cdbf116ed34fbaf294fb9f81da9f318eac"
    DEBUG: ClassVar[uint8] = 10
    INFO: ClassVar[uint8] = 20
    WARN: ClassVar[uint8] = 30
    ERROR: ClassVar[uint8] = 40
    FATAL: ClassVar[uint8] = 50

    stamp: Time = Time()
    level: uint8 = 0
    name: str = ""
    msg: str = ""
    file: str = ""
    function: str = ""
    line: uint32 = 0


@dataclass(frozen=True, slots=True)
class Point(Message):
    TYPE: ClassVar[str] = "geometry_msgs/msg/Point"
    HASH: ClassVar[str] = "RIHS01_6963084842a9b04494d6b2941d11444708d892da2f4b09843b9c43f42a7f6881"

    x: float64 = 0.0
    y: float64 = 0.0
    z: float64 = 0.0


@dataclass(frozen=True, slots=True)
class Pose(Message):
    TYPE: ClassVar[str] = "geometry_msgs/msg/Pose"
    HASH: ClassVar[str] = "RIHS01_d501954e9476cea2996984e812054b68026ae0bfae789d9a10b23daf35cc90fa"

    position: Point = Point()
    orientation: Quaternion = Quaternion()


@dataclass(frozen=True, slots=True)
class ColorRGBA(Message):
    TYPE: ClassVar[str] = "std_msgs/msg/ColorRGBA"
    HASH: ClassVar[str] = "RIHS01_77a7a5b9ae477306097665106e0413ba74440245b1f3d0c6d6405fe5c7813fe8"

    r: float32 = 0.0
    g: float32 = 0.0
    b: float32 = 0.0
    a: float32 = 0.0


@dataclass(frozen=True, slots=True)
class CompressedImage(Message):
    TYPE: ClassVar[str] = "sensor_msgs/msg/CompressedImage"
    HASH: ClassVar[str] = "RIHS01_15640771531571185e2efc8a100baf923961a4d15d5569652e6cb6691e8e371a"

    header: Header = Header()
    format: str = ""
    data: tuple[uint8, ...] = ()


@dataclass(frozen=True, slots=True)
class UVCoordinate(Message):
    TYPE: ClassVar[str] = "visualization_msgs/msg/UVCoordinate"
    HASH: ClassVar[str] = "RIHS01_f27f7ed21fe360c6066944f856b801a0c0d1e94e815b6886444b42d90b196a26"

    u: float32 = 0.0
    v: float32 = 0.0


@dataclass(frozen=True, slots=True)
class MeshFile(Message):
    TYPE: ClassVar[str] = "visualization_msgs/msg/MeshFile"
    HASH: ClassVar[str] = "RIHS01_7710ece15a148fb7c9b546364cfb215bb06098087bd6394fe5b73a493508f8c4"

    filename: str = ""
    data: tuple[uint8, ...] = ()


@dataclass(frozen=True, slots=True)
class Marker(Message):
    TYPE: ClassVar[str] = "visualization_msgs/msg/Marker"
    HASH: ClassVar[str] = "RIHS01_45b13ccf791f225962bf74e746f9644518855d783a6f42ba0cc14fde2b4f3ce0"
    ARROW: ClassVar[int32] = 0
    CUBE: ClassVar[int32] = 1
    SPHERE: ClassVar[int32] = 2
    CYLINDER: ClassVar[int32] = 3
    LINE_STRIP: ClassVar[int32] = 4
    LINE_LIST: ClassVar[int32] = 5
    CUBE_LIST: ClassVar[int32] = 6
    SPHERE_LIST: ClassVar[int32] = 7
    POINTS: ClassVar[int32] = 8
    TEXT_VIEW_FACING: ClassVar[int32] = 9
    MESH_RESOURCE: ClassVar[int32] = 10
    TRIANGLE_LIST: ClassVar[int32] = 11
    ARROW_STRIP: ClassVar[int32] = 12
    ADD: ClassVar[int32] = 0
    MODIFY: ClassVar[int32] = 0
    DELETE: ClassVar[int32] = 2
    DELETEALL: ClassVar[int32] = 3

    header: Header = Header()
    ns: str = ""
    id: int32 = 0
    type: int32 = 0
    action: int32 = 0
    pose: Pose = Pose()
    scale: Vector3 = Vector3()
    color: ColorRGBA = ColorRGBA()
    lifetime: Duration = Duration()
    frame_locked: bool = False
    points: tuple[Point, ...] = ()
    colors: tuple[ColorRGBA, ...] = ()
    texture_resource: str = ""
    texture: CompressedImage = CompressedImage()
    uv_coordinates: tuple[UVCoordinate, ...] = ()
    text: str = ""
    mesh_resource: str = ""
    mesh_file: MeshFile = MeshFile()
    mesh_use_embedded_materials: bool = False


@dataclass(frozen=True, slots=True)
class MarkerArray(Message):
    TYPE: ClassVar[str] = "visualization_msgs/msg/MarkerArray"
    HASH: ClassVar[str] = "RIHS01_86cb8800b6fb05b5eff1abd7a56f62a5641d3ae9a1c29e78e67e704f1d067dcf"

    markers: tuple[Marker, ...] = ()


@dataclass(frozen=True, slots=True)
class TriggerRequest(Message):
    TYPE: ClassVar[str] = "std_srvs/srv/Trigger_Request"
    HASH: ClassVar[str] = "RIHS01_d010825374ce8918e72bfd826c82603e60f45419e932ea976f807b74a863a199"


@dataclass(frozen=True, slots=True)
class TriggerResponse(Message):
    TYPE: ClassVar[str] = "std_srvs/srv/Trigger_Response"
    HASH: ClassVar[str] = "RIHS01_2d946c21e2fc3f1e9ca6986a8191d85fcc70097a8bb7771a053564bc47009cdf"

    success: bool = False
    message: str = ""
