"""The commands that a page gives, out of its code blocks, and programs that take the place of other machines."""

import re
from pathlib import Path
from typing import Final

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
    """Return the text of a page's code blocks of this language."""
    return re.findall(rf"^```{language}\n(.*?)^```", page, re.DOTALL | re.MULTILINE)


def section(page: str, heading: str) -> str:
    """Return a page's text under a heading or a sentence in bold, until the next heading."""
    _, found, rest = page.partition(heading)
    assert found, f"the page has no {heading!r}"
    return re.split(r"^#", rest, maxsplit=1, flags=re.MULTILINE)[0]


def commands(name: str, heading: str) -> list[str]:
    """The lines of a section's shell blocks, of a page of docs/, for bash."""
    page = section((DOCS / name).read_text(), heading)
    return [line for block in blocks(page, "sh") for line in block.splitlines()]


def programs(folder: Path, **texts: str) -> str:
    """These programs in a folder; what PATH begins with, then."""
    folder.mkdir(exist_ok=True)
    for name, text in texts.items():
        (folder / name).write_text(text)
        (folder / name).chmod(0o755)
    return str(folder)
