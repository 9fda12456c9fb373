"""The command lines of programs for a person next to the robot: `drill`, `walk`, `button`."""

import sys
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from gateway.errors import ConfigError
from gateway.people.tools.options import ConnectOption, OtherShapeOption, TimeoutOption, ZenohConfigOption

app = typer.Typer()


class StepName(StrEnum):
    """The drill's steps, in their order, so that `--help` need not load them."""

    COMMAND = "command"
    SET_WHILE_STOPPED = "set-while-stopped"
    SILENCE = "silence"
    ESTOP = "estop"
    UNTIL_RESET = "until-reset"
    AFTER_RESET = "after-reset"
    CUT_LINK = "cut-link"
    LEASE = "lease"
    BUTTON = "button"
    STOP_SERVOS = "stop-servos"
    RESTART = "restart"
    POWER = "power"
    SPI_UNPLUGGED = "spi-unplugged"
    CAN_UNPLUGGED = "can-unplugged"


@app.command()
def drill(
    report: Annotated[
        Path | None, typer.Option("--report", metavar="FILE", help="Write a report: FILE.html, or FILE.json.")
    ] = None,
    leg: Annotated[int, typer.Option("--leg", metavar="N", min=1, max=6, help="The leg that moves.")] = 1,
    angle: Annotated[
        float, typer.Option("--angle", metavar="DEG", min=0, max=180, help="Where it starts, in degrees.")
    ] = 90.0,
    move: Annotated[
        bool, typer.Option("--move", help="Move all three servos of the leg by 15°, not only the first by 5°.")
    ] = False,
    only: Annotated[
        list[StepName] | None,
        typer.Option(
            "--only", metavar="STEP", help=f"Only this step; may be given several times. {', '.join(StepName)}."
        ),
    ] = None,
    late: Annotated[float, typer.Option("--late", metavar="MS", min=1, help="How late a Stop may be.")] = 20.0,
    restart: Annotated[
        bool, typer.Option("--restart", help="Also kill the service (systemd starts it again); as root, on the robot.")
    ] = False,
    unplug: Annotated[
        bool, typer.Option("--unplug", help="Also ask for SPI and the power board's CAN to be unplugged, at the robot.")
    ] = False,
    yes: Annotated[bool, typer.Option("--yes", help="Move a real robot without asking.")] = False,
    config: Annotated[
        Path | None, typer.Option("--config", metavar="PATH", help="The gateway's settings, for stop-servos.")
    ] = None,
    connect: ConnectOption = None,
    zenoh_config: ZenohConfigOption = None,
    timeout: TimeoutOption = 2.0,
) -> None:
    """Prove on this robot, step by step, that it stops, after a change and before people come near.

    It moves one servo by 5° (--move: one leg by 15°), asks before it moves a real robot, and ends with everything
    stopped, also on Ctrl-C. It measures from the frames, where the gateway publishes them (telemetry.frames).

    Exit codes: 0 all passed, 1 not all, or not finished, 2 the robot is not at rest, somebody else drives, nobody
    agreed, or the report cannot be written, 4 no gateway answers.
    """
    from gateway.people.terminal import rows, say
    from gateway.people.tools import reach
    from gateway.people.tools.drill import report as reports
    from gateway.people.tools.drill.run import DRILL_SOURCE, drill

    if report is not None:
        reports.check(report)
    found = drill(
        reach.connection(connect, zenoh_config, timeout, source=DRILL_SOURCE),
        leg=leg,
        angle_deg=angle,
        whole_leg=move,
        agreed=yes,
        only=only or [],
        late_ms=late,
        endpoint=connect,
        zenoh_config=zenoh_config,
        restart=restart,
        unplug=unplug,
        config=config,
    )
    if report is not None:
        reports.write(report, found)
        say(f"report: {report}")
    if found.lost is not None:
        raise found.lost
    failed = [outcome.name for outcome in found.outcomes if outcome.passed is False]
    sentence = "all passed" if found.passed else f"NOT passed: {', '.join(failed) or 'not finished'}"
    sys.exit(rows.conclude(sentence, well=found.passed))


@app.command()
def walk(
    forward: Annotated[
        float, typer.Option("--forward", metavar="M_S", help="Metres a second; below 0: backward.")
    ] = 0.0,
    left: Annotated[float, typer.Option("--left", metavar="M_S", help="Metres a second sideways.")] = 0.0,
    turn: Annotated[float, typer.Option("--turn", metavar="RAD_S", help="Counter-clockwise, radians a second.")] = 0.0,
    seconds: Annotated[
        float | None, typer.Option("--seconds", metavar="S", min=0, max=3600, help="Walk so long, without a person.")
    ] = None,
    gait: Annotated[
        str, typer.Option("--gait", help="In which order the legs step; tripod is the fastest.")
    ] = "tripod",
    height: Annotated[float | None, typer.Option("--height", metavar="M", help="Of the body above the ground.")] = None,
    terrain: Annotated[
        str, typer.Option("--terrain", help="level, or adapt: by the robot's sensors, where it has some.")
    ] = "level",
    geometry: OtherShapeOption = None,
    connect: ConnectOption = None,
    zenoh_config: ZenohConfigOption = None,
    timeout: TimeoutOption = 2.0,
) -> None:
    """Make the robot walk: from the keyboard, or with --seconds without a person.

    W S and the arrows walk and turn while you hold them, A D step sideways, space or e is the emergency stop; the
    screen shows the other keys. It holds the lease meanwhile (see `lease`). Lay the robot on its belly first: its legs
    go to their first pose as fast as they can, one after the other.

    A terminal does not report that a key is released. So a key counts for 0.7 s when it is pressed, which bridges the
    pause before the terminal repeats it, and for 0.2 s after each repetition. Then the robot finishes its step.

    `hexapod-gateway walk --forward 0.1 --seconds 5` stands up, walks, sits down and stops. Ctrl-C (or SIGTERM) has it
    finish its step and sit down before it stops; Ctrl-C again stops it at once, as Ctrl-C does at the keyboard.

    Exit codes: 0 done, 1 rejected or stopped by somebody, 2 it cannot walk so (geometry, limits), 4 no gateway answers,
    130 ended early by a signal.
    """
    from gateway.people.tools import reach

    connection = reach.connection(connect, zenoh_config, timeout, source="hexapod-gateway walk")
    if seconds is not None:
        from gateway.people.tools.walk import script

        sys.exit(script.walk(connection, gait, geometry, terrain, (forward, left, turn), seconds, height))
    if forward or left or turn:
        raise ConfigError("--forward, --left and --turn go with --seconds; without it you drive from the keyboard")
    from gateway.people.tools.walk import screen

    sys.exit(screen.drive(connection, gait, geometry, terrain, height))


@app.command()
def button(
    name: Annotated[
        str | None,
        typer.Option("--name", metavar="N", help="By which name; with a certificate it is that of its person."),
    ] = None,
    connect: ConnectOption = None,
    zenoh_config: ZenohConfigOption = None,
    timeout: TimeoutOption = 2.0,
) -> None:
    """Be a stop button: any key stops the robot, and so does this terminal's silence.

    It checks in with the gateway as long as this terminal is drawn. Where `buttons.required` asks for a button, nothing
    moves without one; if this laptop leaves the Wi-Fi, sleeps or dies, all six legs stop within `buttons.timeout_ms`.

    Ctrl-C leaves on purpose; the robot stops then, too, if too few buttons remain. A certificate for this alone, which
    moves nothing: `hexapod-gateway certs issue NAME --role button`.

    Exit codes: 0 left on purpose, 1 rejected (or no terminal), 4 no gateway.
    """
    from gateway.people.tools import kept_lease, reach
    from gateway.people.tools.button import screen

    name = name or kept_lease.me()
    sys.exit(screen.hold(reach.connection(connect, zenoh_config, timeout, source=name), name))
