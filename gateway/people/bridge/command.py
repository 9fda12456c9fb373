"""The command line of `ros2`."""

import math
import os
import sys
from enum import StrEnum
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Final

import typer

from gateway.people.tools.options import ConnectOption, OtherShapeOption, TimeoutOption, ZenohConfigOption

app = typer.Typer()
ZENOH_RMW: Final = "rmw_zenoh_cpp"


class Via(StrEnum):
    """How the bridge is in ROS 2's graph."""

    ZENOH = "zenoh"
    RCLPY = "rclpy"

    @classmethod
    def usual(cls) -> "Via":
        """By rclpy where it is installed and another RMW than Zenoh is set; else the way that needs no ROS."""
        other = os.environ.get("RMW_IMPLEMENTATION") not in (None, "", ZENOH_RMW)
        return cls.RCLPY if other and find_spec("rclpy") is not None else cls.ZENOH


@app.command()
def ros2(
    ros_args: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[-- ROS_ARGS]", help="With --via rclpy, ROS 2's own: -- --ros-args -r cmd_vel:=/cmd_vel_out"
        ),
    ] = None,
    via: Annotated[
        Via | None,
        typer.Option(
            "--via",
            help="zenoh: as rmw_zenoh speaks, without ROS on this machine. rclpy: by the ROS 2 that is installed, with "
            "its RMW. Default: rclpy where it is installed and RMW_IMPLEMENTATION names another than Zenoh.",
        ),
    ] = None,
    router: Annotated[
        str | None,
        typer.Option(
            "--router",
            metavar="ENDPOINT",
            help="Where ROS 2's Zenoh router (rmw_zenohd) listens. Default: tcp/localhost:7447, or as --router-config.",
        ),
    ] = None,
    router_config: Annotated[
        Path | None,
        typer.Option("--router-config", metavar="PATH", help="A Zenoh configuration with certificates for the router."),
    ] = None,
    domain: Annotated[
        int, typer.Option("--domain", metavar="N", min=0, max=232, envvar="ROS_DOMAIN_ID", help="The ROS domain.")
    ] = 0,
    namespace: Annotated[
        str, typer.Option("--ros-namespace", metavar="NAME", help="Of its topics and services; / for none.")
    ] = "/hexapod",
    distribution: Annotated[
        str,
        typer.Option(
            "--distro", metavar="NAME", envvar="ROS_DISTRO", help="Of the peers: jazzy, kilted, lyrical or humble."
        ),
    ] = "jazzy",
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
    open_graph: Annotated[
        bool,
        typer.Option(
            "--open-graph", help="Start although others reach the graph without certificates: they can drive."
        ),
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
    """Put the robot into a ROS 2 graph: over Zenoh (rmw_zenoh) without ROS on this machine, or as a node of rclpy.

    It publishes joint_states, robot_description and diagnostics, and what the robot measures: battery_state, imu/data
    and temperature. It takes joint_commands, joint_trajectory, cmd_vel (cmd_vel_stamped), cmd_base_height,
    roll_setpoint, pitch_setpoint, cmd_gait_type and goals of the action follow_joint_trajectory, once somebody has
    called its service drive; it holds the lease then, until release. The service estop is for everybody, always. reset
    leaves an emergency stop that came through ROS alone while the bridge drove.

    Exit codes: 0 ended on request, 2 the extra \\[ros2] or rclpy is missing, or an argument or a file is wrong, 4 no
    gateway answers, or no ROS 2 router.
    """
    from gateway.people.bridge import run
    from gateway.people.bridge.parameters import Parameters
    from gateway.people.tools import reach

    sys.exit(
        run.serve(
            partial(reach.connection, connect, zenoh_config, timeout),
            by_rclpy=(via or Via.usual()) is Via.RCLPY,
            ros_args=ros_args or [],
            router=router,
            router_config=router_config,
            allow_reset=allow_reset,
            open_graph=open_graph,
            domain=domain,
            namespace=namespace,
            distribution=distribution,
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
