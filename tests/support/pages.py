"""Commands that pages and messages contain, parsed by the program's own parser; the metrics page and its list."""

import ast
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import click
from prometheus_client.parser import text_string_to_metric_families

from tests.support.command import program

DOCS: Final = Path(__file__).parents[2] / "docs"

SSH: Final = """#!/bin/sh
cd "$HOSTS/$1" && shift && HOME=$PWD exec sh -c "$*"
"""
SCP: Final = """#!/bin/sh
for last; do :; done
for file; do [ "$file" = "$last" ] || cp "$file" "$HOSTS/${last%%:*}/${last#*:}" || exit; done
"""
SUDO: Final = """#!/bin/sh
exec "$@"
"""
"""An ssh and an scp whose hosts are the folders of $HOSTS, and a sudo for root."""


def blocks(page: str, language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", page, re.DOTALL | re.MULTILINE)


def section(page: str, heading: str) -> str:
    """Return a page's text under a heading or a sentence in bold, until the next heading."""
    _, found, rest = page.partition(heading)
    assert found, f"the page has no {heading!r}"
    return re.split(r"^#", rest, maxsplit=1, flags=re.MULTILINE)[0]


def commands(name: str, heading: str) -> list[str]:
    """Return the lines of a section's shell blocks, of a page of docs/, for bash."""
    page = section((DOCS / name).read_text(), heading)
    return [line for block in blocks(page, "sh") for line in block.splitlines()]


def programs(folder: Path, **texts: str) -> str:
    """Return these programs in a folder, for the beginning of PATH."""
    folder.mkdir(exist_ok=True)
    for name, text in texts.items():
        (folder / name).write_text(text)
        (folder / name).chmod(0o755)
    return str(folder)


_COMMAND = re.compile(r"(?P<quoted>`?)hexapod-gateway (?P<rest>[^`→]*)")
_OWN = re.compile(r"\{run\[([^]]*)\]\}")
_PLACEHOLDER = re.compile(r"\{[^}]*\}")
_VALUE = re.compile(r"[A-Z][A-Z_0-9]*\b|.*[/.\d]")
"""A value on a command line: no word of prose matches."""
_NO_VALUE = frozenset({"//", "(7)"})
_END = ",;:.)"


def parse_commands(text: str) -> list[list[str]]:
    """Parse each, and return their words. Raises UsageError for a command that the program would reject.

    A name in `backticks` without arguments, or alone, is no command to copy: it has to exist.
    """
    commands = []
    for each in _COMMAND.finditer(_PLACEHOLDER.sub("7", _OWN.sub(r"hexapod-gateway \1", text))):
        words = _words(each["rest"])
        named = each["quoted"] and " ".join(words) == each["rest"]
        if words and not named:
            _parse(words)
            if words[0] == "certs" and "--dir" not in each["rest"] and each[0] != text:
                raise click.UsageError(f"{' '.join(words)} finds no folder of certificates without --dir")
        commands += [words] if words else []
    return commands


def texts(source: str, shown: Callable[[ast.expr], str]) -> list[str]:
    """Return the strings of a module but its docstrings, each on one line, and each value in them as `shown` has it."""
    tree = ast.parse(source)
    inner = {id(part) for node in ast.walk(tree) if isinstance(node, ast.JoinedStr) for part in node.values}
    inner |= {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    found = [
        node for node in ast.walk(tree) if isinstance(node, ast.JoinedStr | ast.Constant) and id(node) not in inner
    ]
    parts = [node.values if isinstance(node, ast.JoinedStr) else [node] for node in found]
    whole = (
        "".join(str(each.value) if isinstance(each, ast.Constant) else shown(each) for each in few) for few in parts
    )
    return [" ".join(text.split()) for text in whole]


def _words(rest: str) -> list[str]:
    """Return the words up to where the sentence continues."""
    command = program()
    words: list[str] = []
    value, arguments = False, list[Any]()
    for each in rest.split():
        word = each if "(" in each else each.rstrip(_END)
        known = getattr(command, "commands", {})
        if word in known:
            command = known[word]
            arguments = [each for each in command.params if each.param_type_name == "argument" and each.required]
        elif not words or not (value or each[0] == "-" or arguments or (_VALUE.match(word) and each not in _NO_VALUE)):
            break
        options = [option for option in command.params if word in option.opts]
        if not (word in known or value or each[0] == "-"):
            arguments = arguments[1:]
        value = each[0] == "-" and not any(option.is_flag for option in options)
        words.append(word)
        if word != each:
            break
    return words


def _parse(words: list[str]) -> None:
    command = program()
    context = command.make_context("hexapod-gateway", words)
    while hasattr(command, "commands"):
        left = [*context._protected_args, *context.args]
        if not left and command.invoke_without_command:
            return
        name, command, rest = command.resolve_command(context, left)
        context = command.make_context(name, rest, parent=context)


Described = set[tuple[str, str, frozenset[str]]]
_DOCS: Final = Path(__file__).parents[2] / "docs" / "recordings.md"
_OF: Final = re.compile(r"^For a robot ", re.MULTILINE)


def documented(robot: str = "") -> Described:
    """Return what the docs list for every robot, or for one "that measures" or "with a power board"."""
    always, *further = _OF.split(_DOCS.read_text())
    (section,) = [each for each in further if each.startswith(robot)] if robot else [always]
    rows = re.findall(r"^\| `((?:hexapod|process)_\w+)` \| (\w+) \| (.*?) \|", section, re.MULTILINE)
    return {(name, kind, frozenset(re.findall(r"`(\w+)`", labels))) for name, kind, labels in rows}


def described(page: str) -> Described:
    """Return the metrics of a page."""
    found = set()
    for each in text_string_to_metric_families(page):
        labels = frozenset(label for sample in each.samples for label in sample.labels) - {"le"}
        name = f"{each.name}_total" if each.type == "counter" else each.name
        found.add((name, "info" if name.endswith("_info") else each.type, labels))
    return found
