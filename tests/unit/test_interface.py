"""docs/interface.md is true and complete: each of its tables is compared with the code."""

import re
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Union, get_args, get_origin

import pytest
import typer
from pydantic import BaseModel

from gateway import errors
from gateway.cli import app
from gateway.robot.core import supervisor
from release import settings_page
from schemas import keys
from schemas.button import Alive, ButtonAck, Leave, Register
from schemas.calibration import Calibration, CalibrationCommand
from schemas.command import LegCommand, LegsCommand, MoveCommand, ResetCommand, StopCommand
from schemas.lease import Challenge, Claim, LeaseAck, Proof, Release, Renew
from schemas.revocation import RevocationAck, RevocationRequest
from schemas.robot import LEGS, SERVO_IDS
from schemas.state import StateReport
from schemas.telemetry import (
    Ack,
    BodyReport,
    Cause,
    ConfigReport,
    Event,
    FrameRecord,
    Kind,
    Mode,
    Reason,
    Telemetry,
    WatchdogState,
)

INTERFACE = (Path(__file__).parents[2] / "docs" / "interface.md").read_text()


def rows(heading: str) -> list[list[str]]:
    """The cells of the table below a heading, its head left out."""
    _, _, section = INTERFACE.partition(f"\n{heading}\n")
    assert section, f"docs/interface.md has no heading {heading!r}"
    table = re.search(r"(?:^\|.*\n)+", section.partition("\n#")[0] + "\n", re.MULTILINE)
    assert table is not None, f"nothing stands in a table below {heading!r}"
    lines = table[0].splitlines()[2:]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


def names(heading: str) -> list[str]:
    """The first column, without its backticks."""
    return [row[0].strip("`") for row in rows(heading)]


def parts(annotation: Any) -> list[Any]:
    """What a type is made of: `float | None` → float, None; `tuple[A, ...]` → A."""
    if get_origin(annotation) in (Annotated, Union, UnionType, tuple):
        return [part for argument in get_args(annotation) for part in parts(argument)]
    return [annotation]


def fields(model: type[BaseModel]) -> set[str]:
    """The fields of a payload, those of the objects inside as `legs[].leg` and `spi.device`."""
    found: set[str] = set()
    for name, field in model.model_fields.items():
        inner = {part for part in parts(field.annotation) if isinstance(part, type) and issubclass(part, BaseModel)}
        joint = "[]." if get_origin(field.annotation) is tuple else "."
        found |= {f"{name}{joint}{deeper}" for part in inner for deeper in fields(part)} or {name}
    return found


@pytest.mark.parametrize(
    "model",
    [
        Ack,
        LeaseAck,
        RevocationAck,
        ButtonAck,
        Calibration,
        StateReport,
        ConfigReport,
        Event,
        FrameRecord,
        Telemetry,
        BodyReport,
    ],
)
def test_what_goes_out_has_these_fields(model: type[BaseModel]) -> None:
    assert sorted(names(f"### {model.__name__}")) == sorted(fields(model))


def test_what_comes_in_has_these_fields() -> None:
    assert set(names("### ServoCommand")) == set(MoveCommand.model_fields) | set(StopCommand.model_fields)
    for model in (LegCommand, LegsCommand, ResetCommand, CalibrationCommand, RevocationRequest):
        assert set(names(f"### {model.__name__}")) == set(model.model_fields)
    pressed = {name for model in (Register, Alive, Leave) for name in model.model_fields}
    assert set(names("### ButtonRequest")) == pressed - {"proof"} | {f"proof.{name}" for name in Proof.model_fields}
    asked = {name for model in (Challenge, Claim, Renew, Release) for name in model.model_fields}
    assert set(names("### LeaseRequest")) == asked - {"proof"} | {f"proof.{name}" for name in Proof.model_fields}


@pytest.mark.parametrize("values", [Reason, Mode, Kind, Cause, WatchdogState])
def test_these_are_all_values(values: Any) -> None:
    assert sorted(names(f"### {values.__name__}")) == sorted(values)


def test_these_are_all_keys() -> None:
    written = {row[0].strip("`"): row[1] for row in rows("## Keys")}
    spelled = {"leg/{1..6}": [f"leg/{leg}" for leg in LEGS], "servo/{11..63}": [f"servo/{each}" for each in SERVO_IDS]}
    found: dict[str, str] = {}
    for key, direction in written.items():
        pattern = next((pattern for pattern in spelled if pattern in key), None)
        for name in spelled[pattern] if pattern else [""]:
            found[key.replace(pattern, name) if pattern else key] = direction
    get_only = {*keys.GET_ONLY, keys.SIM_UPRIGHT}
    assert {key for key, direction in found.items() if direction == "in"} == set(keys.COMMAND_KEYS)
    assert {key for key, direction in found.items() if direction == "in, `get` only"} == get_only
    out = {value for name, value in vars(keys).items() if name.isupper() and isinstance(value, str)}
    out -= {keys.ROOT, keys.ALL_COMMANDS, *get_only, *keys.COMMAND_KEYS}
    assert {key for key, direction in found.items() if direction == "out"} == out


def test_each_reference_to_a_rule_names_one() -> None:
    """Rules have names: a number means another rule once one is added."""
    behaviour = INTERFACE.partition("\n## Behaviour\n")[2].partition("\n## ")[0]
    rules = {name.rstrip(".") for name in re.findall(r"^(?:- |   )\*\*([^*]+)\*\*", behaviour, re.MULTILINE)}
    assert {"Start", "Legs at rest", "Power"} <= rules
    root = Path(__file__).parents[2]
    files = [path for room in ("gateway", "docs", "schemas") for path in (root / room).rglob("*.[mp][dy]")]
    named, numbered = dict[str, Path](), list[Path]()
    for path in files:
        text = re.sub(r"\s+", " ", path.read_text(encoding="utf-8"))
        named |= dict.fromkeys(re.findall(r"Behaviours? \*([^*]+)\*", text), path)
        numbered += [path] if re.search(r"Behaviours?,? (?:rule )?\d", text) else []
    named |= dict.fromkeys(re.findall(r"^\*([^*]+)\*: ", supervisor.__doc__ or "", re.MULTILINE), Path("supervisor.py"))
    assert numbered == []
    assert {name: path for name, path in named.items() if name not in rules} == {}
    assert len(named) > len("Legs at rest")


def test_settings_come_from_their_table(capsys: pytest.CaptureFixture[str]) -> None:
    """Also the JSON Schema of gateway.toml."""
    assert settings_page.main(["--check"]) == 0, capsys.readouterr().err


def commands() -> list[str]:
    """Every command's name."""
    found: list[str] = []

    def walk(command: Any, path: list[str]) -> None:
        for name, inner in getattr(command, "commands", {}).items():
            walk(inner, [*path, name])
        if not hasattr(command, "commands") or path == ["calibrate"]:  # (`incidents` alone is `incidents list`)
            found.append(" ".join(path))

    walk(typer.main.get_command(app), [])
    return found


def test_these_are_all_commands_and_help_has_each_exit_code() -> None:
    written = {row[0].strip("`"): row[2] for row in rows("## Commands")}
    assert sorted(written) == sorted(commands())
    assert len({name.partition(" ")[0] for name in written}) == 17, "at most so many, a group counted as one"
    help_ = str(typer.main.get_command(app).epilog).partition("Exit codes:")[2]
    raised = {str(each.exit_code) for each in vars(errors).values() if hasattr(each, "exit_code")}
    codes = {code for text in written.values() for code in re.findall(r"\b\d+\b", text)}
    assert set(re.findall(r"\b\d+\b", help_)) == codes | raised
