"""The command line of the drill."""

import sys
from pathlib import Path
from typing import Annotated, Final

import typer

from gateway.errors import ConfigError
from gateway.people.tools.options import ConnectOption, TimeoutOption, ZenohConfigOption

app = typer.Typer()

STEP_NAMES: Final = (
    "command",
    "set-while-stopped",
    "silence",
    "estop",
    "until-reset",
    "after-reset",
    "cut-link",
    "lease",
    "button",
    "stop-servos",
    "restart",
)
"""Their names, without loading them for every other command; a test compares them."""


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
        list[str] | None,
        typer.Option(
            "--only", metavar="STEP", help=f"Only this step; may be given several times. {', '.join(STEP_NAMES)}."
        ),
    ] = None,
    late: Annotated[float, typer.Option("--late", metavar="MS", min=1, help="How late a Stop may be.")] = 20.0,
    restart: Annotated[
        bool, typer.Option("--restart", help="Also kill the service (systemd starts it again); as root, on the robot.")
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
    from gateway.people.terminal import say
    from gateway.people.tools import reach
    from gateway.people.tools.drill import report as reports
    from gateway.people.tools.drill.run import SOURCE, drill, unknown_steps
    from gateway.people.tools.drill.steps import STEPS

    unknown = unknown_steps(only or [])
    if unknown:
        raise ConfigError(f"{unknown[0]} is no step; they are {', '.join(step.name for step in STEPS)}")
    if report is not None:
        reports.check(report)
    found = drill(
        reach.connection(connect, zenoh_config, timeout, source=SOURCE),
        leg=leg,
        angle_deg=angle,
        whole_leg=move,
        agreed=yes,
        only=only or [],
        late_ms=late,
        endpoint=connect,
        zenoh_config=zenoh_config,
        restart=restart,
        config=config,
    )
    if report is not None:
        reports.write(report, found)
        say(f"report: {report}")
    if found.lost is not None:
        raise found.lost
    failed = [outcome.name for outcome in found.outcomes if outcome.passed is False]
    say("all passed" if found.passed else f"NOT passed: {', '.join(failed) or 'not finished'}")
    sys.exit(0 if found.passed else 1)
