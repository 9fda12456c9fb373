"""ROS 2's message types, written by `python -m tests.support.ros2_messages`: do not edit.

They are the same in all of `DISTRIBUTIONS` (rosbags keeps their definitions). Fields are documented where ROS 2 is.
"""

from typing import Annotated, ClassVar, Final

from gateway.people.ros2.cdr import Message, byte, float32, float64, int32, ros_msg, uint8, uint32

DISTRIBUTIONS: Final = ("humble", "jazzy", "kilted", "lyrical")

TRIGGER_TYPE: Final = "std_srvs/srv/Trigger"
TRIGGER_HASH: Final = "RIHS01_eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f"
"""Of the service; its request and response have hashes of their own, which nothing on the wire shows."""


@ros_msg("std_msgs/msg/String", "df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18")
class String(Message):
    data: str = ""


@ros_msg("std_msgs/msg/Int32", "b6578ded3c58c626cfe8d1a6fb6e04f706f97e9f03d2727c9ff4e74b1cef0deb")
class Int32(Message):
    data: int32 = 0


@ros_msg("std_msgs/msg/Float64", "705ba9c3d1a09df43737eb67095534de36fd426c0587779bda2bc51fe790182a")
class Float64(Message):
    data: float64 = 0.0


@ros_msg("std_msgs/msg/MultiArrayDimension", "5e773a60a4c7fc8a54985f307c7837aa2994252a126c301957a24e31282c9cbe")
class MultiArrayDimension(Message):
    label: str = ""
    size: uint32 = 0
    stride: uint32 = 0


@ros_msg("std_msgs/msg/MultiArrayLayout", "4c66e6f78e740ac103a94cf63259f968e48c617e7699e829b63c21a5cb50dac6")
class MultiArrayLayout(Message):
    dim: tuple[MultiArrayDimension, ...] = ()
    data_offset: uint32 = 0


@ros_msg("std_msgs/msg/Float64MultiArray", "1025ddc6b9552d191f89ef1a8d2f60f3d373e28b283d8891ddcc974e8c55397f")
class Float64MultiArray(Message):
    layout: MultiArrayLayout = MultiArrayLayout()
    data: tuple[float64, ...] = ()


@ros_msg("builtin_interfaces/msg/Time", "b106235e25a4c5ed35098aa0a61a3ee9c9b18d197f398b0e4206cea9acf9c197")
class Time(Message):
    sec: int32 = 0
    nanosec: uint32 = 0


@ros_msg("std_msgs/msg/Header", "f49fb3ae2cf070f793645ff749683ac6b06203e41c891e17701b1cb597ce6a01")
class Header(Message):
    stamp: Time = Time()
    frame_id: str = ""


@ros_msg("sensor_msgs/msg/JointState", "a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e")
class JointState(Message):
    header: Header = Header()
    name: tuple[str, ...] = ()
    position: tuple[float64, ...] = ()
    velocity: tuple[float64, ...] = ()
    effort: tuple[float64, ...] = ()


@ros_msg("diagnostic_msgs/msg/KeyValue", "d68081eaa540288c5440753baecef0c4e16e81a5f78ad68902ded5100413bb42")
class KeyValue(Message):
    key: str = ""
    value: str = ""


@ros_msg("diagnostic_msgs/msg/DiagnosticStatus", "b0e3e692ea2d54a8af2f4ef1930e81556a2db55216b771f8a7d2724ed47bf0e4")
class DiagnosticStatus(Message):
    OK: ClassVar[byte] = 0
    WARN: ClassVar[byte] = 1
    ERROR: ClassVar[byte] = 2
    STALE: ClassVar[byte] = 3

    level: byte = 0
    name: str = ""
    message: str = ""
    hardware_id: str = ""
    values: tuple[KeyValue, ...] = ()


@ros_msg("diagnostic_msgs/msg/DiagnosticArray", "5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e")
class DiagnosticArray(Message):
    header: Header = Header()
    status: tuple[DiagnosticStatus, ...] = ()


@ros_msg("geometry_msgs/msg/Vector3", "cc12fe83e4c02719f1ce8070bfd14aecd40f75a96696a67a2a1f37f7dbb0765d")
class Vector3(Message):
    x: float64 = 0.0
    y: float64 = 0.0
    z: float64 = 0.0


@ros_msg("geometry_msgs/msg/Twist", "9c45bf16fe0983d80e3cfe750d6835843d265a9a6c46bd2e609fcddde6fb8d2a")
class Twist(Message):
    linear: Vector3 = Vector3()
    angular: Vector3 = Vector3()


@ros_msg("geometry_msgs/msg/TwistStamped", "5f0fcd4f81d5d06ad9b4c4c63e3ea51b82d6ae4d0558f1d475229b1121db6f64")
class TwistStamped(Message):
    header: Header = Header()
    twist: Twist = Twist()


@ros_msg("geometry_msgs/msg/Quaternion", "8a765f66778c8ff7c8ab94afcc590a2ed5325a1d9a076ffff38fbce36f458684")
class Quaternion(Message):
    x: float64 = 0.0
    y: float64 = 0.0
    z: float64 = 0.0
    w: float64 = 0.0


@ros_msg("geometry_msgs/msg/Transform", "beb83fbe698636351461f6f35d1abb20010c43d55374d81bd041f1ba2581fddc")
class Transform(Message):
    translation: Vector3 = Vector3()
    rotation: Quaternion = Quaternion()


@ros_msg("geometry_msgs/msg/TransformStamped", "0a241f87d04668d94099cbb5ba11691d5ad32c2f29682e4eb5653424bd275206")
class TransformStamped(Message):
    header: Header = Header()
    child_frame_id: str = ""
    transform: Transform = Transform()


@ros_msg("tf2_msgs/msg/TFMessage", "e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087")
class TFMessage(Message):
    transforms: tuple[TransformStamped, ...] = ()


@ros_msg("builtin_interfaces/msg/Duration", "e8d009f659816f758b75334ee1a9ca5b5c0b859843261f14c7f937349599d93b")
class Duration(Message):
    sec: int32 = 0
    nanosec: uint32 = 0


@ros_msg("trajectory_msgs/msg/JointTrajectoryPoint", "de8907036d8bd45aac6f30cc9044a3d4a329c42cbf719aff7d95a584cfa532d7")
class JointTrajectoryPoint(Message):
    positions: tuple[float64, ...] = ()
    velocities: tuple[float64, ...] = ()
    accelerations: tuple[float64, ...] = ()
    effort: tuple[float64, ...] = ()
    time_from_start: Duration = Duration()


@ros_msg("trajectory_msgs/msg/JointTrajectory", "179b33eba59d676f6d967ac71fe35e7ca2f64b2f3928f4a018cec115e213796e")
class JointTrajectory(Message):
    header: Header = Header()
    joint_names: tuple[str, ...] = ()
    points: tuple[JointTrajectoryPoint, ...] = ()


@ros_msg("rcl_interfaces/msg/Log", "e28ce254ca8abc06abf92773b74602cdbf116ed34fbaf294fb9f81da9f318eac")
class Log(Message):
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


@ros_msg("geometry_msgs/msg/Point", "6963084842a9b04494d6b2941d11444708d892da2f4b09843b9c43f42a7f6881")
class Point(Message):
    x: float64 = 0.0
    y: float64 = 0.0
    z: float64 = 0.0


@ros_msg("geometry_msgs/msg/Pose", "d501954e9476cea2996984e812054b68026ae0bfae789d9a10b23daf35cc90fa")
class Pose(Message):
    position: Point = Point()
    orientation: Quaternion = Quaternion()


@ros_msg("std_msgs/msg/ColorRGBA", "77a7a5b9ae477306097665106e0413ba74440245b1f3d0c6d6405fe5c7813fe8")
class ColorRGBA(Message):
    r: float32 = 0.0
    g: float32 = 0.0
    b: float32 = 0.0
    a: float32 = 0.0


@ros_msg("sensor_msgs/msg/CompressedImage", "15640771531571185e2efc8a100baf923961a4d15d5569652e6cb6691e8e371a")
class CompressedImage(Message):
    header: Header = Header()
    format: str = ""
    data: tuple[uint8, ...] = ()


@ros_msg("visualization_msgs/msg/UVCoordinate", "f27f7ed21fe360c6066944f856b801a0c0d1e94e815b6886444b42d90b196a26")
class UVCoordinate(Message):
    u: float32 = 0.0
    v: float32 = 0.0


@ros_msg("visualization_msgs/msg/MeshFile", "7710ece15a148fb7c9b546364cfb215bb06098087bd6394fe5b73a493508f8c4")
class MeshFile(Message):
    filename: str = ""
    data: tuple[uint8, ...] = ()


@ros_msg("visualization_msgs/msg/Marker", "45b13ccf791f225962bf74e746f9644518855d783a6f42ba0cc14fde2b4f3ce0")
class Marker(Message):
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


@ros_msg("visualization_msgs/msg/MarkerArray", "86cb8800b6fb05b5eff1abd7a56f62a5641d3ae9a1c29e78e67e704f1d067dcf")
class MarkerArray(Message):
    markers: tuple[Marker, ...] = ()


@ros_msg("sensor_msgs/msg/Imu", "7d9a00ff131080897a5ec7e26e315954b8eae3353c3f995c55faf71574000b5b")
class ImuMessage(Message):
    header: Header = Header()
    orientation: Quaternion = Quaternion()
    orientation_covariance: Annotated[tuple[float64, ...], 9] = (0.0,) * 9
    angular_velocity: Vector3 = Vector3()
    angular_velocity_covariance: Annotated[tuple[float64, ...], 9] = (0.0,) * 9
    linear_acceleration: Vector3 = Vector3()
    linear_acceleration_covariance: Annotated[tuple[float64, ...], 9] = (0.0,) * 9


@ros_msg("sensor_msgs/msg/BatteryState", "4bee5dfce981c98faa6828b868307a0a73f992ed0789f374ee96c8f840e69741")
class BatteryState(Message):
    POWER_SUPPLY_STATUS_UNKNOWN: ClassVar[uint8] = 0
    POWER_SUPPLY_STATUS_CHARGING: ClassVar[uint8] = 1
    POWER_SUPPLY_STATUS_DISCHARGING: ClassVar[uint8] = 2
    POWER_SUPPLY_STATUS_NOT_CHARGING: ClassVar[uint8] = 3
    POWER_SUPPLY_STATUS_FULL: ClassVar[uint8] = 4
    POWER_SUPPLY_HEALTH_UNKNOWN: ClassVar[uint8] = 0
    POWER_SUPPLY_HEALTH_GOOD: ClassVar[uint8] = 1
    POWER_SUPPLY_HEALTH_OVERHEAT: ClassVar[uint8] = 2
    POWER_SUPPLY_HEALTH_DEAD: ClassVar[uint8] = 3
    POWER_SUPPLY_HEALTH_OVERVOLTAGE: ClassVar[uint8] = 4
    POWER_SUPPLY_HEALTH_UNSPEC_FAILURE: ClassVar[uint8] = 5
    POWER_SUPPLY_HEALTH_COLD: ClassVar[uint8] = 6
    POWER_SUPPLY_HEALTH_WATCHDOG_TIMER_EXPIRE: ClassVar[uint8] = 7
    POWER_SUPPLY_HEALTH_SAFETY_TIMER_EXPIRE: ClassVar[uint8] = 8
    POWER_SUPPLY_TECHNOLOGY_UNKNOWN: ClassVar[uint8] = 0
    POWER_SUPPLY_TECHNOLOGY_NIMH: ClassVar[uint8] = 1
    POWER_SUPPLY_TECHNOLOGY_LION: ClassVar[uint8] = 2
    POWER_SUPPLY_TECHNOLOGY_LIPO: ClassVar[uint8] = 3
    POWER_SUPPLY_TECHNOLOGY_LIFE: ClassVar[uint8] = 4
    POWER_SUPPLY_TECHNOLOGY_NICD: ClassVar[uint8] = 5
    POWER_SUPPLY_TECHNOLOGY_LIMN: ClassVar[uint8] = 6
    POWER_SUPPLY_TECHNOLOGY_TERNARY: ClassVar[uint8] = 7
    POWER_SUPPLY_TECHNOLOGY_VRLA: ClassVar[uint8] = 8

    header: Header = Header()
    voltage: float32 = 0.0
    temperature: float32 = 0.0
    current: float32 = 0.0
    charge: float32 = 0.0
    capacity: float32 = 0.0
    design_capacity: float32 = 0.0
    percentage: float32 = 0.0
    power_supply_status: uint8 = 0
    power_supply_health: uint8 = 0
    power_supply_technology: uint8 = 0
    present: bool = False
    cell_voltage: tuple[float32, ...] = ()
    cell_temperature: tuple[float32, ...] = ()
    location: str = ""
    serial_number: str = ""


@ros_msg("sensor_msgs/msg/Temperature", "72514a14126ab9f8a9abec974c78e5610a367b59db5da355ff1fb982d5bad4b8")
class Temperature(Message):
    header: Header = Header()
    temperature: float64 = 0.0
    variance: float64 = 0.0


@ros_msg("std_srvs/srv/Trigger_Request", "d010825374ce8918e72bfd826c82603e60f45419e932ea976f807b74a863a199")
class TriggerRequest(Message):
    """It has no fields."""


@ros_msg("std_srvs/srv/Trigger_Response", "2d946c21e2fc3f1e9ca6986a8191d85fcc70097a8bb7771a053564bc47009cdf")
class TriggerResponse(Message):
    success: bool = False
    message: str = ""
