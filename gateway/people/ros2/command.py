"""The command line of `ros2`."""

import math
import sys
from functools import partial
from typing import Annotated

import typer

from gateway.people.commands.options import ConnectOption, OtherShapeOption, TimeoutOption, ZenohConfigOption

app = typer.Typer()


@app.command()
def ros2(
    ros_args: Annotated[
        list[str] | None,
        typer.Argument(metavar="[-- ROS_ARGS]", help="ROS 2's own arguments: -- --ros-args -r cmd_vel:=/cmd_vel_out"),
    ] = None,
    domain: Annotated[
        int, typer.Option("--domain", metavar="N", min=0, max=232, envvar="ROS_DOMAIN_ID", help="The ROS domain.")
    ] = 0,
    namespace: Annotated[
        str, typer.Option("--ros-namespace", metavar="NAME", help="Of its topics and services; / for none.")
    ] = "/hexapod",
    joint_names: Annotated[
        str,
        typer.Option(
            "--joint-names", metavar="PATTERN", help="Of the joints in messages: leg{leg}_J{joint} are the Elkapod's."
        ),
    ] = "joint_{leg}{joint}",
    drive: Annotated[
        bool, typer.Option("--drive", help="Drive from the beginning; else the service drive must be called.")
    ] = False,
    allow_reset: Annotated[
        bool,
        typer.Option("--allow-reset", help="Let the service reset leave any emergency stop, a person's, too."),
    ] = False,
    tf: Annotated[
        bool, typer.Option("--tf", help="Publish /tf, too: for viewers without a robot_state_publisher.")
    ] = False,
    joint_states_hz: Annotated[
        float, typer.Option("--joint-states-hz", metavar="HZ", help="At most so many joint states a second, 1 to 50.")
    ] = 50.0,
    diagnostics_hz: Annotated[
        float, typer.Option("--diagnostics-hz", metavar="HZ", help="At least so many diagnostics a second, 0.1 to 10.")
    ] = 1.0,
    base_frame: Annotated[
        str, typer.Option("--base-frame", metavar="NAME", help="The body's frame: of the URDF, /tf and measurements.")
    ] = "base",
    imu_frame: Annotated[
        str, typer.Option("--imu-frame", metavar="NAME", help="The frame of imu/data. Default: the body's.")
    ] = "",
    uncommanded_deg: Annotated[
        float | None,
        typer.Option(
            "--uncommanded-deg",
            metavar="DEG",
            help="Where joint_states has servos that were never commanded, 0 to 180. Default: they are left out.",
        ),
    ] = None,
    geometry: OtherShapeOption = None,
    connect: ConnectOption = None,
    zenoh_config: ZenohConfigOption = None,
    timeout: TimeoutOption = 2.0,
) -> None:
    """Put the robot into a ROS 2 graph: a node of the ROS 2 that is installed here, over whatever RMW is set.

    It publishes joint_states, robot_description and diagnostics, and what the robot measures: battery_state, imu/data
    and temperature. It takes joint_commands, joint_trajectory, cmd_vel (cmd_vel_stamped), cmd_base_height,
    roll_setpoint, pitch_setpoint, cmd_gait_type and goals of the action follow_joint_trajectory, once somebody has
    called its service drive; it holds the lease then, until release. The service estop is for everybody, always. reset
    leaves an emergency stop that came through ROS alone while the bridge drove.
    """
    from gateway.people.commands import reach
    from gateway.people.ros2 import run
    from gateway.people.ros2.parameters import Parameters

    sys.exit(
        run.serve(
            partial(reach.connection, connect, zenoh_config, timeout),
            ros_args=ros_args or [],
            allow_reset=allow_reset,
            domain=domain,
            namespace=namespace,
            joint_names=joint_names,
            parameters=Parameters(
                joint_states_hz=joint_states_hz,
                diagnostics_hz=diagnostics_hz,
                base_frame=base_frame,
                imu_frame=imu_frame,
                uncommanded_deg=math.nan if uncommanded_deg is None else uncommanded_deg,
            ),
            drives=drive,
            with_tf=tf,
            geometry=geometry,
        )
    )
