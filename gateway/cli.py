"""The command line: each command calls one function; an error is one line and an exit code.

Each command imports its modules when it runs, so that an emergency stop does not wait for those of other commands.
"""

import atexit
import os
import signal
import sys
import threading
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, Literal, NoReturn

import typer
from typer.core import TyperCommand, TyperGroup

from gateway import __version__
from gateway.errors import ConfigError, GatewayError
from gateway.host import output
from gateway.model.frames import PROTOCOL_VERSION
from gateway.onboard import commands
from gateway.people import console, recorder, ros2
from gateway.people.commands import certs, walk
from gateway.people.commands.options import ConfigOption, JsonOption, Reach, reaches
from gateway.people.terminal import hint
from gateway.words.own_command import command as own_command

_PANELS = {
    "Stop": ("estop", "stop", "reset"),
    "Look": ("status", "console", "record", "incidents"),
    "Drive": ("walk", "send", "ros2"),
    "The robot": ("run", "setup", "check", "calibrate", "stop-servos"),
    "People": ("certs",),
    "Files": ("decode",),
}
"""The groups of `--help`, the urgent commands first."""
_OPS = ("start", "set")
_PACKAGED = (Path(__file__).parents[1] / "units/hexapod-gateway.service").is_file()
"""Whether this is the release of a Debian package: only that can be set up, so `setup` is its command alone."""


class _Commands(TyperGroup):
    """All commands in their panels. Removes pydantic's prefix, which Typer's parser adds, from error messages."""

    def list_commands(self, ctx: Any) -> list[str]:
        del ctx
        return [name for names in _PANELS.values() for name in names if name in self.commands]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        command: Any = super().get_command(ctx, cmd_name)
        if command is None and cmd_name == "setup":
            raise ConfigError("setup is a command of the Debian package: sudo apt install ./hexapod-gateway_….deb")
        if command is None and cmd_name in _OPS:
            example = f"{own_command('send leg 3 start 90 45 120')}; to stand up and go: {own_command('walk')}"
            raise ConfigError(f"{cmd_name} is a word of `send`: {example}")
        for panel, names in _PANELS.items():
            if cmd_name in names:
                command.rich_help_panel = panel
        return command

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        _name_no_type_of_flags(self, ctx)
        return super().parse_args(ctx, args)

    def invoke(self, ctx: Any) -> Any:
        try:
            return super().invoke(ctx)
        except typer.BadParameter as error:
            error.message = error.message.removeprefix("Value error, ")
            raise


def _name_no_type_of_flags(command: Any, ctx: Any) -> None:
    """Let the help print `--json`, and not `--json <bool>`, which nobody can type."""
    for option in (*command.params, command.get_help_option(ctx)):
        if getattr(option, "is_flag", False) and option.metavar is None:
            option.metavar = ""
    for each in getattr(command, "commands", {}).values():
        _name_no_type_of_flags(each, ctx)


app = typer.Typer(
    cls=_Commands,
    rich_markup_mode="markdown",
    name="hexapod-gateway",
    help="Move a six-legged robot: take commands over Zenoh, write servo frames to SPI, and stop the robot when "
    "commands stop coming.",
    epilog="Try it without a robot: `hexapod-gateway run --sim`, and in a second terminal "
    "`hexapod-gateway send legs start 90 45 120 --hold 5`.\n\n"
    "Exit codes: 0 done, or ended on request; 1 rejected, failed, not confirmed, or the output cannot be written; 2 an "
    "argument, a file or the configuration is wrong; 3 the SPI device fails; 4 no gateway answers, or Zenoh cannot be "
    "opened, such as when its address is taken; 5 the address of the console or the live view is taken; 6 "
    "another gateway holds the SPI device, UART or plug-in; 130 ended "
    "early by a signal.",
    no_args_is_help=True,
    add_completion=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"hexapod-gateway {__version__} (HexapodProtocol {PROTOCOL_VERSION})")
        raise typer.Exit


@app.callback()
def _options(
    ctx: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    del version
    if ctx.invoked_subcommand not in ("run", "console"):  # systemd counts a service's end by SIGTERM as a clean one
        signal.signal(signal.SIGTERM, signal.default_int_handler)


class Sim(StrEnum):
    """Values of `--sim`."""

    CONTROLLER = "controller"
    PHYSICS = "physics"


class _SimMayStandAlone(TyperCommand):
    """Takes `--sim` without a value as `--sim=controller`."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        return super().parse_args(ctx, [f"--sim={Sim.CONTROLLER}" if each == "--sim" else each for each in args])


def _physics(metavar: str, text: str, default: str, least: float | None = None, most: float | None = None) -> Any:
    """Return an option of `--sim=physics`."""
    return typer.Option(metavar=metavar, min=least, max=most, help=f"Physics: {text}.", show_default=default)


@app.command(cls=_SimMayStandAlone)
def run(
    config: ConfigOption = None,
    sim: Annotated[
        Sim | None,
        typer.Option(
            "--sim",
            metavar="[=physics]",
            help="Simulate the controller, without SPI. With =physics its servos move a body that can fall.",
        ),
    ] = None,
    geometry: Annotated[Path | None, _physics("FILE", "another robot's shape (JSON)", "the Elkapod's")] = None,
    mass_kg: Annotated[float | None, _physics("KG", "mass of the whole robot", "2.68: assumed", 0.2, 50)] = None,
    servo_torque_nm: Annotated[
        float | None, _physics("NM", "highest torque of each servo", "2.0: a servo of 20 kg·cm", 0.1, 50)
    ] = None,
    friction: Annotated[
        float | None, _physics("MU", "friction of feet on the ground", "0.8: rubber on wood", 0.01, 3)
    ] = None,
    terrain: Annotated[
        str | None, _physics("GROUND", "flat, slope:DEGREES (ahead, up), rough:METRES or step:METRES", "flat")
    ] = None,
) -> None:
    """Run the service until SIGTERM or Ctrl-C.

    The service first stops all six legs, then takes commands.

    With --sim=physics the simulated robot has a body (MuJoCo, in its own process) that walks and falls. Its position
    is published on hexapod/sim/body; the console and `record` draw it. Masses and forces are assumed: nobody has
    weighed the Elkapod.
    """
    from gateway.onboard import serve

    physics = (geometry, mass_kg, servo_torque_nm, friction, terrain)
    if sim is not Sim.PHYSICS and physics != (None,) * len(physics):
        raise ConfigError("--geometry, --mass-kg, --servo-torque-nm, --friction and --terrain go with --sim=physics")
    body = None
    if sim is Sim.PHYSICS:
        from gateway.people.physics.assumed import assumed

        body = geometry, assumed(mass_kg, servo_torque_nm, friction, terrain)
    serve.serve(config, simulated=sim is not None, body=body)


@app.command("stop-servos")
def stop_servos(config: ConfigOption = None) -> None:
    """Stop all six legs directly over SPI, and cut the servos' power, without Zenoh and without a running gateway.

    Use it when the service has died, or may have. systemd runs it each time the service ends. It uses the settings of
    the service, and reports each difference from the file.
    """
    from gateway.onboard import stop

    if not stop.run(config):
        raise typer.Exit(stop.NOT_CONFIRMED)


def _one_word(name: str, text: str) -> None:
    """Add a command that sends one request without options of its own."""

    @app.command(name, help=text)
    @reaches
    def command(reach: Reach) -> None:
        from gateway.people.commands import send

        sys.exit(getattr(send, name)(send.connection(reach, name)))


_one_word("stop", "Stop all six legs. They can be started again at once; after `estop` only a `reset` allows that.")
_one_word("estop", "Engage the emergency stop: all six legs stop at once, and stay stopped until `reset`.")
_one_word("reset", "End the emergency stop. No servo moves until somebody starts it again.")


@app.command()
@reaches
def status(
    reach: Reach,
    follow: Annotated[
        bool, typer.Option("--follow", "-f", help="Print a line for each change, rejection and event, until Ctrl-C.")
    ] = False,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print JSON as the gateway publishes it; with --follow, one object per line.")
    ] = False,
) -> None:
    """Show the robot's state in sentences: may it move, what runs, who drives, what has gone wrong.

    With --follow it prints a line for each change, rejection and event, with the reason, and waits if no gateway runs
    yet. Its Ctrl-C does not stop the robot: keep `estop` or a console within reach.
    """
    if follow:
        from gateway.people.commands.status import follow as follow_state

        follow_state(reach, as_json=as_json)
    from gateway.people.commands.status import status

    status(reach, as_json=as_json)


@app.command()
def decode(
    hex_bytes: Annotated[list[str], typer.Argument(metavar="HEX…", help="A frame's bytes, such as 06 02 20 02 00 00")],
    as_json: JsonOption = False,
) -> None:
    """Explain the bytes of a frame, or name what is wrong with them.

    Several frames may follow each other; each begins with its length.
    """
    from gateway.people.commands import decode

    sys.exit(decode.decode(hex_bytes, as_json=as_json))


app.add_typer(console.app)
app.add_typer(console.calibrate_app, name="calibrate")
app.add_typer(certs.app, name="certs")
app.add_typer(recorder.app)
app.add_typer(commands.incidents_app, name="incidents")
app.add_typer(commands.check_app)
if _PACKAGED:
    app.add_typer(commands.setup_app)
app.add_typer(walk.app)
app.add_typer(ros2.app)

send_app = typer.Typer(
    help="Send one acknowledged command through a running gateway.\n\n"
    "`start` switches servos on: they go to their angles at once, as fast as they can. `set` moves servos that run. "
    "`stop` switches them off.\n\n"
    "The watchdog stops the leg after watchdog.timeout_ms without a further command. --hold repeats the command every "
    "50 ms. If the lease is free, --hold also holds the lease: then nobody else drives.",
    no_args_is_help=True,
)
app.add_typer(send_app, name="send")

HoldOption = Annotated[
    float, typer.Option("--hold", metavar="S", min=0, help="Repeat the command every 50 ms for this many seconds.")
]
OpArgument = Annotated[Literal["start", "set", "stop"], typer.Argument(metavar="OP", help="start, set or stop")]


@send_app.command("leg")
@reaches
def send_leg(
    *,
    leg: Annotated[int, typer.Argument(metavar="N", min=1, max=6, help="The leg, 1 to 6")],
    op: OpArgument,
    angles: Annotated[
        list[float] | None,
        typer.Argument(metavar="[A B C]", help="Degrees, 0 to 180, for joints 1, 2 and 3; not for stop"),
    ] = None,
    hold: HoldOption = 0,
    reach: Reach,
) -> None:
    """Start, set or stop a leg: `send leg 3 start 90 45 120 --hold 5`."""
    from gateway.people.commands import send

    sys.exit(send.send(send.connection(reach), "leg", leg, op, angles or [], hold_s=hold))


@send_app.command("legs")
@reaches
def send_legs(
    *,
    op: OpArgument,
    angles: Annotated[
        list[float] | None,
        typer.Argument(metavar="[A B C]", help="Degrees for joints 1, 2 and 3 of every leg, or 18 angles, legs 1 to 6"),
    ] = None,
    hold: HoldOption = 0,
    reach: Reach,
) -> None:
    """Start, set or stop all six legs: `send legs start 90 45 120 --hold 5`."""
    from gateway.people.commands import send

    sys.exit(send.send(send.connection(reach), "legs", 0, op, angles or [], hold_s=hold))


@send_app.command("servo")
@reaches
def send_servo(
    *,
    servo_id: Annotated[int, typer.Argument(metavar="ID", help="Leg, then joint: 32 is joint 2 of leg 3")],
    op: OpArgument,
    angle: Annotated[float | None, typer.Argument(metavar="[A]", help="Degrees, 0 to 180; not for stop")] = None,
    hold: HoldOption = 0,
    reach: Reach,
) -> None:
    """Start, set or stop one servo: `send servo 32 start 90`."""
    from gateway.people.commands import send

    angles = [] if angle is None else [angle]
    sys.exit(send.send(send.connection(reach), "servo", servo_id, op, angles, hold_s=hold))


def main() -> None:
    """Run the command line. An error becomes one line per fault on stderr and an exit code."""
    try:
        app(prog_name="hexapod-gateway")  # also as `python -m gateway`
    except GatewayError as error:
        for line in str(error).splitlines():
            hint(f"hexapod-gateway: {line}")
        _end(error.exit_code)
    except RuntimeError as error:
        if "home directory" not in str(error):  # pathlib's, for a user without HOME and without an entry in passwd
            raise
        hint(
            "hexapod-gateway: this user has no home folder, in which this command keeps its files: set HOME to a folder"
        )
        _end(ConfigError.exit_code)
    except KeyboardInterrupt:
        _end(130)
    except SystemExit as end:
        if not isinstance(end.code, int):
            raise
        _end(end.code)


def _end(code: int) -> NoReturn:
    """End with this exit code, without Python's own end if threads are left.

    It would wait for those that still try to reach another host, and abort when a daemon returns from Zenoh.
    """
    code = output.finish(code)
    question = sys.modules.get("gateway.people.client.question")
    if (question is not None and question.under_way()) or any(thread.daemon for thread in threading.enumerate()):
        atexit._run_exitfuncs()
        os._exit(code)
    sys.exit(code)
