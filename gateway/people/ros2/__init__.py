"""`ros2`: the robot in a ROS 2 graph, as a node of rclpy. Recordings and incidents have its messages.

Here is the command line alone.
"""

import sys
from typing import Annotated, NamedTuple

import typer

from gateway.people.commands.options import OtherShapeOption, Reach, reaches

app = typer.Typer()


class BridgeOptions(NamedTuple):
    """The options of the bridge."""

    ros_args: Annotated[
        list[str] | None,
        typer.Argument(metavar="[-- ROS_ARGS]", help="ROS 2's own arguments: -- --ros-args -r cmd_vel:=/cmd_vel_out"),
    ] = None
    domain: Annotated[
        int, typer.Option(metavar="N", min=0, max=232, envvar="ROS_DOMAIN_ID", help="The ROS domain.")
    ] = 0
    namespace: Annotated[
        str, typer.Option("--ros-namespace", metavar="NAME", help="Namespace of the topics and services; / for none.")
    ] = "/hexapod"
    joint_names: Annotated[
        str, typer.Option(metavar="PATTERN", help="Joint names in messages. The Elkapod's: leg{leg}_J{joint}.")
    ] = "joint_{leg}{joint}"
    drive: Annotated[bool, typer.Option("--drive", help="Drive at once, without a call of the service drive.")] = False
    allow_reset: Annotated[
        bool,
        typer.Option("--allow-reset", help="Let the service reset leave the emergency stop, also a person's."),
    ] = False
    tf: Annotated[
        bool,
        typer.Option("--tf", help="Also publish /tf, for viewers without a robot_state_publisher."),
    ] = False
    joint_states_hz: Annotated[float, typer.Option(metavar="HZ", help="Most joint states a second, 1 to 50.")] = 50.0
    diagnostics_hz: Annotated[float, typer.Option(metavar="HZ", help="Fewest diagnostics a second, 0.1 to 10.")] = 1.0
    base_frame: Annotated[
        str, typer.Option(metavar="NAME", help="Name of the body's frame in the URDF, /tf and measurements.")
    ] = "base"
    imu_frame: Annotated[str, typer.Option(metavar="NAME", help="The frame of imu/data. Default: the body's.")] = ""
    uncommanded_deg: Annotated[
        float | None,
        typer.Option(
            metavar="DEG",
            help="Angle in joint_states of servos that were never commanded, 0 to 180. Default: left out.",
        ),
    ] = None
    geometry: OtherShapeOption = None


@app.command()
@reaches
def ros2(options: BridgeOptions, reach: Reach) -> None:
    """Connect the robot to ROS 2, as a node of the ROS 2 that is installed here, over any RMW.

    It publishes joint_states, robot_description and diagnostics, and what the robot measures: battery_state,
    imu/data and temperature. After a call of its service drive it holds the lease and takes joint_commands, cmd_vel
    (cmd_vel_stamped), cmd_base_height, roll_setpoint, pitch_setpoint and cmd_gait_type. The service release ends
    this. Everybody may call estop at any time. The service reset leaves the emergency stop only with --allow-reset.
    """
    from gateway.people.ros2 import run

    sys.exit(run.serve(reach.connection, options))
