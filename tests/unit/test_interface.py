"""docs/interface.md is true and complete, and what docs/safety.md names exists: keys, tests, scenes, settings."""

import ast
import json
import re
from dataclasses import asdict
from functools import cache
from pathlib import Path
from typing import Final

import pytest

from gateway import errors
from gateway.robot.core import supervisor
from gateway.robot.settings import Settings
from release import interface_page
from schemas import __main__ as messages
from schemas import keys
from schemas.keys import COMMAND_KEYS, Target, leg_command, parse, servo_command
from schemas.robot import LEGS, SERVO_IDS
from tests.kernel.inside.scenes import SCENES

ROOT = Path(__file__).parents[2]
INTERFACE = (ROOT / "docs" / "interface.md").read_text()


def rows(heading: str) -> list[list[str]]:
    """Return the cells of the table below a heading, its head left out."""
    _, _, section = INTERFACE.partition(f"\n{heading}\n")
    assert section, f"docs/interface.md has no heading {heading!r}"
    table = re.search(r"(?:^\|.*\n)+", section.partition("\n#")[0] + "\n", re.MULTILINE)
    assert table is not None, f"nothing stands in a table below {heading!r}"
    lines = table[0].splitlines()[2:]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


def names(heading: str) -> list[str]:
    return [row[0].strip("`") for row in rows(heading)]


def test_tables_are_those_of_the_code(capsys: pytest.CaptureFixture[str]) -> None:
    """Fields, words, settings, commands and exit codes; also the JSON Schema of gateway.toml."""
    assert interface_page.main(["--check"]) == 0, capsys.readouterr().err


def test_a_field_without_a_description_has_no_row(monkeypatch: pytest.MonkeyPatch) -> None:
    document = {"properties": {"angle_deg": {"type": "number"}}, "additionalProperties": False}
    monkeypatch.setattr(messages, "documents", lambda: {"Command.json": json.dumps(document)})
    with pytest.raises(ValueError, match=r"Command\.angle_deg has no description"):
        interface_page.tables()


def test_the_table_of_keys_has_all_keys() -> None:
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
    files = [path for room in ("gateway", "docs", "schemas") for path in (ROOT / room).rglob("*.[mp][dy]")]
    named, numbered = dict[str, Path](), list[Path]()
    for path in files:
        text = re.sub(r"\s+", " ", path.read_text(encoding="utf-8"))
        named |= dict.fromkeys(re.findall(r"Behaviours? \*([^*]+)\*", text), path)
        numbered += [path] if re.search(r"Behaviours?,? (?:rule )?\d", text) else []
    named |= dict.fromkeys(re.findall(r"^\*([^*]+)\*: ", supervisor.__doc__ or "", re.MULTILINE), Path("supervisor.py"))
    assert numbered == []
    assert {name: path for name, path in named.items() if name not in rules} == {}
    assert len(named) > len("Legs at rest")


def test_each_rule_names_a_test() -> None:
    behaviour = INTERFACE.partition("\n## Behaviour\n")[2].partition("\n## ")[0]
    named = dict(re.findall(r"^- \*([^*]+)\*: `([^`]+)`$", INTERFACE, re.MULTILINE))
    assert list(named) == [name.rstrip(".") for name in re.findall(r"^- \*\*([^*]+)\*\*", behaviour, re.MULTILINE)]
    for name, test in named.items():
        path, _, function = test.partition("::")
        assert always_skipped((ROOT / "tests" / path).read_text(encoding="utf-8"), function) is False, name


def test_commands_are_few_and_exit_codes_are_those_of_errors() -> None:
    assert len({name.partition(" ")[0] for name in names("## Commands")}) == 17, (
        "at most so many, a group counted as one"
    )
    raised = {str(each.exit_code) for each in vars(errors).values() if hasattr(each, "exit_code")}
    assert raised <= set(names("### Exit codes"))


PAGE: Final = (ROOT / "docs" / "safety.md").read_text(encoding="utf-8")


@cache
def _marks(text: str) -> dict[str, list[str]]:
    tests = [node for node in ast.parse(text).body if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)]
    return {test.name: [ast.unparse(mark) for mark in test.decorator_list] for test in tests}


def always_skipped(text: str, function: str) -> bool | None:
    """Return whether a test in a file with this text is always skipped; None: there is no such test."""
    marks = _marks(text).get(function)
    if marks is None:
        return None
    return any(re.search(r"mark\.(skip|xfail)\b", mark) for mark in marks) or bool(
        re.search(r"^pytestmark\b.*\b(skip|xfail)\b|^pytest\.skip\(", text, re.MULTILINE)
    )


def test_each_test_that_it_names_exists_and_is_not_skipped() -> None:
    def text(file: str) -> str:
        path = ROOT / "tests" / file
        return path.read_text(encoding="utf-8") if path.exists() else ""

    named = sorted({tuple(name.split("::")) for name in re.findall(r"`([\w/]+\.py::\w+)`", PAGE)})
    assert named
    assert [f"{file}::{test}" for file, test in named if always_skipped(text(file), test) is not False] == []


def test_each_claim_names_what_shows_it() -> None:
    rows = [row for row in PAGE.partition("\n## The case\n")[2].partition("\n## ")[0].splitlines() if row[:2] == "| "]
    assert len(rows) > len(("hazard", "and one claim"))
    assert [row for row in rows[1:] if len(cells := row.split(" | ")) != len("hctd") or "::" not in cells[2]] == []


def test_each_setting_that_it_names_exists() -> None:
    sections = asdict(Settings())
    named = [each for each in re.findall(r"`([a-z_]+)\.([a-z_]+)\b(?!\()", PAGE) if each[0] in sections]
    assert named
    assert [f"{section}.{name}" for section, name in named if name not in sections[section]] == []


def test_each_kernel_scene_that_it_names_exists() -> None:
    named = [scene for row in re.findall(r"`make kernel`: ([^|<]+)", PAGE) for scene in re.findall(r"`([\w-]+)`", row)]
    assert named
    assert [scene for scene in named if scene not in SCENES] == []


def test_commands_of_one_instant_apply_in_this_order() -> None:
    targets = [parsed.target for parsed in COMMAND_KEYS.values()]
    assert targets == [Target.LEGS, *[Target.LEG] * 6, *[Target.SERVO] * 18, Target.ESTOP, Target.RESET]


NO_LEG = "does not exist; legs are 1 to 6"
NO_SERVO = "does not exist; an id is the leg (1 to 6) and the joint (1 to 3), such as 32"
NO_KEY = "is no command key; they are leg/1..6, servo/11..63, legs, estop and reset"


@pytest.mark.parametrize(("leg", "servo_id"), [(-1, -11), (0, 0), (7, 71), (11, 14), (64, 64)])
def test_no_key_for_a_leg_or_a_servo_that_is_none(leg: int, servo_id: int) -> None:
    with pytest.raises(ValueError, match=f"^leg {leg} {NO_LEG}$"):
        leg_command(leg)
    with pytest.raises(ValueError, match=f"^servo {servo_id} {re.escape(NO_SERVO)}"):
        servo_command(servo_id)


@pytest.mark.parametrize(
    ("key", "sentence"),
    [
        ("hexapod/leg/01/cmd", f"leg 01 {NO_LEG}"),
        ("hexapod/servo/14/cmd", f"servo 14 {NO_SERVO}"),
        ("hexapod/leg/1/2/cmd", f"hexapod/leg/1/2/cmd {NO_KEY}"),
        ("", f'"" {NO_KEY}'),
        ("hexapod/leg/a\nb/cmd", rf'leg "a\nb" {NO_LEG}'),
        (f"hexapod/servo/{'9' * 999}/cmd", f"servo {'9' * 60}… {NO_SERVO}"),
        ("hexapod/\x1b[2J/cmd", rf'"hexapod/\u001b[2J/cmd" {NO_KEY}'),
    ],
)
def test_what_is_no_command_key(key: str, sentence: str) -> None:
    with pytest.raises(ValueError, match=f"^{re.escape(sentence)}$"):
        parse(key)
