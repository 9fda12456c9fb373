"""docs/interface.md is true and complete: each of its tables is compared with the code."""

import json
import re
from pathlib import Path

import pytest

from gateway import errors
from gateway.robot.core import supervisor
from release import interface_page
from schemas import __main__ as messages
from schemas import keys
from schemas.robot import LEGS, SERVO_IDS
from tests.unit.test_safety import always_skipped

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
    """Return the first column, without its backticks."""
    return [row[0].strip("`") for row in rows(heading)]


def test_tables_are_those_of_the_code(capsys: pytest.CaptureFixture[str]) -> None:
    """Fields, words, settings, commands and exit codes; also the JSON Schema of gateway.toml."""
    assert interface_page.main(["--check"]) == 0, capsys.readouterr().err


@pytest.mark.parametrize(
    "row",
    [
        '| `op` | `"start"` or `"set"` or `"stop"` | energise and set, set, or de-energise |',
        "| `to` | 1 to 64 characters? | with `release`: the next holder, one that asked |",
        "| `legs.age_ms` | 6 × number? | since an accepted start or set; null: none |",
        "| `servo_silent` | a running servo draws nothing for 1 s | |",
    ],
)
def test_a_row_states_type_limits_and_meaning(row: str) -> None:
    assert row in INTERFACE.splitlines()


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
