"""Sets one value in the text of a TOML file; everything else stays, comments included."""

import json
import re
from typing import Any

from gateway import nesting
from gateway.errors import ConfigError

_TABLE = re.compile(r"\s*\[")


def with_value(text: str, table: str, name: str, value: str) -> str:
    """The text with `table.name = value`: in place of the old value, else of its comment, else as a new line.

    Raises ConfigError if the text states it in a way that a person has to change.
    """
    said, quoted = f"{name} = {json.dumps(value)}", r"""("[^"\n]*"|'[^'\n]*')"""
    lines = text.rstrip("\n").split("\n")
    begin = next((at for at, line in enumerate(lines) if re.match(rf"\s*\[\s*{table}\s*\]", line)), None)
    first_table = next((at for at, line in enumerate(lines) if _TABLE.match(line)), len(lines))
    inside = range(0)
    if begin is not None:
        after = (at for at in range(begin + 1, len(lines)) if _TABLE.match(lines[at]))
        inside = range(begin + 1, next(after, len(lines)))
    stated = [(at, rf"(\s*{name}\s*=\s*){quoted}(.*)") for at in inside]
    stated += [(at, rf"(\s*{table}\.{name}\s*=\s*){quoted}(.*)") for at in range(first_table)]
    old = next((at for at, pattern in stated if re.fullmatch(pattern, lines[at])), None)
    comments = [at for at in inside if re.match(rf"# *{name} *=", lines[at])]
    dotted = any(re.match(rf"\s*{table}\s*\.", line) for line in lines[:first_table])
    if old is not None:
        pattern = dict(stated)[old]
        lines[old] = re.sub(pattern, lambda found: f"{found[1]}{json.dumps(value)}{found[3]}", lines[old])
    elif comments:
        lines[comments[-1]] = said
    elif begin is not None:
        lines.insert(begin + 1, said)
    elif dotted:
        lines.insert(0, f"{table}.{said}")
    else:
        lines += ["", f"[{table}]", said]
    changed = "\n".join([*lines, ""])
    if not _differs_by_this_alone(text, changed, table, name, value):
        raise ConfigError(f"states {table}.{name} in a way that a person has to change; it needs {said} in [{table}]")
    return changed


def _differs_by_this_alone(before: str, after: str, table: str, name: str, value: str) -> bool:
    wanted: dict[str, Any] = nesting.read_toml(before.encode())
    wanted.setdefault(table, {})[name] = value
    try:
        return nesting.read_toml(after.encode()) == wanted
    except ValueError:
        return False
