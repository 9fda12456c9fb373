"""The command line of `ros2`."""

import sys
from typing import Annotated

import typer

from gateway.people.tools.options import ConnectOption, OtherShapeOption, TimeoutOption, ZenohConfigOption

app = typer.Typer()


@app.command()
def ros2(
    router: Annotated[
        str, typer.Option("--router", metavar="ENDPOINT", help="Where ROS 2's Zenoh router (rmw_zenohd) listens.")
    ] = "tcp/localhost:7447",
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
    drive: Annotated[
        bool, typer.Option("--drive", help="Drive from the beginning; else the service drive must be called.")
    ] = False,
    tf: Annotated[
        bool, typer.Option("--tf", help="Publish /tf, too: for viewers without a robot_state_publisher.")
    ] = False,
    geometry: OtherShapeOption = None,
    connect: ConnectOption = None,
    zenoh_config: ZenohConfigOption = None,
    timeout: TimeoutOption = 2.0,
) -> None:
    """Put the robot into a ROS 2 graph (rmw_zenoh), without ROS on this machine.

    It publishes joint_states, robot_description and diagnostics. It takes joint_commands, joint_trajectory, cmd_vel
    (cmd_vel_stamped), cmd_base_height, roll_setpoint, pitch_setpoint and cmd_gait_type, once somebody has called its
    service drive; it holds the lease then, until release. The services estop and reset are for everybody, always.

    Exit codes: 0 ended on request, 2 the extra \\[ros2] is missing, or an argument or a file is wrong, 4 no gateway
    answers, or no ROS 2 router.
    """
    from gateway.people.bridge import run
    from gateway.people.tools import reach

    connection = reach.connection(connect, zenoh_config, timeout, source=run.NAME)
    sys.exit(
        run.serve(
            connection,
            router=router,
            domain=domain,
            namespace=namespace,
            distribution=distribution,
            drives=drive,
            with_tf=tf,
            geometry=geometry,
        )
    )
