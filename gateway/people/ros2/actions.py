"""What the action FollowJointTrajectory sends, written by `python -m tests.support.ros2_messages`: do not edit.

As control_msgs 4 and 5 (Humble, Jazzy) and 6 up to 6.2 define it; since 6.3 its feedback has another field.
"""

from typing import Annotated, ClassVar, Final

from gateway.people.ros2.cdr import Message, float64, int8, int32, ros_msg, uint8, uint16
from gateway.people.ros2.messages import (
    Duration,
    Header,
    JointTrajectory,
    JointTrajectoryPoint,
    Time,
    Transform,
    Twist,
)

SEND_GOAL: Final = (
    "control_msgs/action/FollowJointTrajectory_SendGoal",
    "RIHS01_b13789dddc325a7a962825c45e28c77d37237ec129dd0c34dc5994562938c57f",
)
GET_RESULT: Final = (
    "control_msgs/action/FollowJointTrajectory_GetResult",
    "RIHS01_e3ceb38e3e1867c8dc0f46014df26e90eb93422f27e9e97f936e07f94be4bc8b",
)
CANCEL_GOAL: Final = (
    "action_msgs/srv/CancelGoal",
    "RIHS01_573d8b0a534451d7bc2ac8c5ffde8ac14b8593b7001175d0cd6516dcbeb8689a",
)
"""Type and hash of each service."""


@ros_msg("unique_identifier_msgs/msg/UUID", "1b8e8aca958cbea28fe6ef60bf6c19b683c97a9ef60bb34752067d0f2f7ab437")
class UUID(Message):
    uuid: Annotated[tuple[uint8, ...], 16] = (0,) * 16


@ros_msg(
    "trajectory_msgs/msg/MultiDOFJointTrajectoryPoint",
    "6ada1085b5ee64eaa069b074968e69f0e27c8c5e6f5bb0586dd1c834ef0e32b8",
)
class MultiDOFJointTrajectoryPoint(Message):
    transforms: tuple[Transform, ...] = ()
    velocities: tuple[Twist, ...] = ()
    accelerations: tuple[Twist, ...] = ()
    time_from_start: Duration = Duration()


@ros_msg(
    "trajectory_msgs/msg/MultiDOFJointTrajectory",
    "3a18fd095292a65cfde8833c72985a30af981f3ec44494655c6267262b443a4a",
)
class MultiDOFJointTrajectory(Message):
    header: Header = Header()
    joint_names: tuple[str, ...] = ()
    points: tuple[MultiDOFJointTrajectoryPoint, ...] = ()


@ros_msg("control_msgs/msg/JointTolerance", "c254f9cece0f3b733017b6990fd46d1326e25242d6b8844398c97d9a88e7d648")
class JointTolerance(Message):
    name: str = ""
    position: float64 = 0.0
    velocity: float64 = 0.0
    acceleration: float64 = 0.0


@ros_msg("control_msgs/msg/JointComponentTolerance", "739ea7566931944d33830fa10f1bf5e7a7fbdc3172bce7a7eaac642bd6e3ffa4")
class JointComponentTolerance(Message):
    joint_name: str = ""
    component: uint16 = 0
    position: float64 = 0.0
    velocity: float64 = 0.0
    acceleration: float64 = 0.0


@ros_msg(
    "control_msgs/action/FollowJointTrajectory_Goal",
    "8a9060704b269608f5a340934cc26e66869dd14bdac29e2e7fd9ec8b9882d205",
)
class FollowGoal(Message):
    trajectory: JointTrajectory = JointTrajectory()
    multi_dof_trajectory: MultiDOFJointTrajectory = MultiDOFJointTrajectory()
    path_tolerance: tuple[JointTolerance, ...] = ()
    component_path_tolerance: tuple[JointComponentTolerance, ...] = ()
    goal_tolerance: tuple[JointTolerance, ...] = ()
    component_goal_tolerance: tuple[JointComponentTolerance, ...] = ()
    goal_time_tolerance: Duration = Duration()


@ros_msg(
    "control_msgs/action/FollowJointTrajectory_SendGoal_Request",
    "179c93691f1f6d1d115881ff88c3917b7cc6eac2ba4bf56766cc7c4389e19ef1",
)
class FollowSendGoalRequest(Message):
    goal_id: UUID = UUID()
    goal: FollowGoal = FollowGoal()


@ros_msg(
    "control_msgs/action/FollowJointTrajectory_SendGoal_Response",
    "e6a48ba740ae254500129a877f0b071be8663a115da1a539b74599cc97921fbf",
)
class FollowSendGoalResponse(Message):
    accepted: bool = False
    stamp: Time = Time()


@ros_msg(
    "control_msgs/action/FollowJointTrajectory_GetResult_Request",
    "ecf7ea8463d3beec7084bca75216d0b01b87b6e1e4e09679bb26093041efcbe9",
)
class FollowGetResultRequest(Message):
    goal_id: UUID = UUID()


@ros_msg(
    "control_msgs/action/FollowJointTrajectory_Result",
    "8002e99ed2c14c6faa522f2a93c26d744c5982f254f9e98ff9c6f19789bdb220",
)
class FollowResult(Message):
    SUCCESSFUL: ClassVar[int32] = 0
    INVALID_GOAL: ClassVar[int32] = -1
    INVALID_JOINTS: ClassVar[int32] = -2
    OLD_HEADER_TIMESTAMP: ClassVar[int32] = -3
    PATH_TOLERANCE_VIOLATED: ClassVar[int32] = -4
    GOAL_TOLERANCE_VIOLATED: ClassVar[int32] = -5

    error_code: int32 = 0
    error_string: str = ""


@ros_msg(
    "control_msgs/action/FollowJointTrajectory_GetResult_Response",
    "08eefbaa146ce02ba45898d5e99160afd6c4c54a30d159aee0f2ca6035b1580f",
)
class FollowGetResultResponse(Message):
    status: int8 = 0
    result: FollowResult = FollowResult()


@ros_msg("action_msgs/msg/GoalInfo", "6398fe763154554353930716b225947f93b672f0fb2e49fdd01bb7a7e37933e9")
class GoalInfo(Message):
    goal_id: UUID = UUID()
    stamp: Time = Time()


@ros_msg("action_msgs/srv/CancelGoal_Request", "3d3c84653c1f96918086887e1dcb236faec88b81a5b14fd4cf4840065bcdf8af")
class CancelGoalRequest(Message):
    goal_info: GoalInfo = GoalInfo()


@ros_msg("action_msgs/srv/CancelGoal_Response", "35e682cf3f510e83c70a82a4aac888496dedee56773bf9d8e5e0aa81f9e1c960")
class CancelGoalResponse(Message):
    ERROR_NONE: ClassVar[int8] = 0
    ERROR_REJECTED: ClassVar[int8] = 1
    ERROR_UNKNOWN_GOAL_ID: ClassVar[int8] = 2
    ERROR_GOAL_TERMINATED: ClassVar[int8] = 3

    return_code: int8 = 0
    goals_canceling: tuple[GoalInfo, ...] = ()


@ros_msg("action_msgs/msg/GoalStatus", "32f4cfd717735d17657e1178f24431c1ce996c878c515230f6c5b3476819dbb9")
class GoalStatus(Message):
    STATUS_UNKNOWN: ClassVar[int8] = 0
    STATUS_ACCEPTED: ClassVar[int8] = 1
    STATUS_EXECUTING: ClassVar[int8] = 2
    STATUS_CANCELING: ClassVar[int8] = 3
    STATUS_SUCCEEDED: ClassVar[int8] = 4
    STATUS_CANCELED: ClassVar[int8] = 5
    STATUS_ABORTED: ClassVar[int8] = 6

    goal_info: GoalInfo = GoalInfo()
    status: int8 = 0


@ros_msg("action_msgs/msg/GoalStatusArray", "6c1684b00f177d37438febe6e709fc4e2b0d4248dca4854946f9ed8b30cda83e")
class GoalStatusArray(Message):
    status_list: tuple[GoalStatus, ...] = ()


@ros_msg(
    "control_msgs/action/FollowJointTrajectory_Feedback",
    "3fd0aaecf71725121ae1ff7f01098a5e0da581e672be18a6b2c286cb43d96b49",
)
class FollowFeedback(Message):
    header: Header = Header()
    joint_names: tuple[str, ...] = ()
    desired: JointTrajectoryPoint = JointTrajectoryPoint()
    actual: JointTrajectoryPoint = JointTrajectoryPoint()
    error: JointTrajectoryPoint = JointTrajectoryPoint()
    multi_dof_joint_names: tuple[str, ...] = ()
    multi_dof_desired: MultiDOFJointTrajectoryPoint = MultiDOFJointTrajectoryPoint()
    multi_dof_actual: MultiDOFJointTrajectoryPoint = MultiDOFJointTrajectoryPoint()
    multi_dof_error: MultiDOFJointTrajectoryPoint = MultiDOFJointTrajectoryPoint()


@ros_msg(
    "control_msgs/action/FollowJointTrajectory_FeedbackMessage",
    "80398fcb9674a79081a9906e2ccf0c804dd7cb15e22e362e606ee87186beab71",
)
class FollowFeedbackMessage(Message):
    goal_id: UUID = UUID()
    feedback: FollowFeedback = FollowFeedback()
