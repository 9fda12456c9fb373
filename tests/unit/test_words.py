"""Words that are no longer used: each has another name in the field, or says nothing."""

import io
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import pytest

ROOT: Final = Path(__file__).parents[2]
PAGES: Final = [
    *sorted(ROOT.glob("*.md")),
    *sorted((ROOT / "docs").rglob("*.md")),
    *sorted((ROOT / "examples").rglob("*.md")),
]
CODE: Final = sorted(
    path for home in ("gateway", "schemas", "examples", "release") for path in (ROOT / home).rglob("*.py")
)
PAGE: Final = sorted(
    path
    for path in (ROOT / "gateway/people/console/page").rglob("*")
    if path.suffix in {".js", ".html"} and "three" not in path.parts
)
INSTEAD: Final = {
    r"(door)?bells?": "wakeup",
    r"doorkeepers?": "connection limiter",
    r"tellers?": "event publisher",
    r"outlets?": "log writer",
    r"strangers?": "unknown key",
    r"mend(s|ed|ing)?": "fix",
    r"held up": "delayed",
    r"watched": "armed",
    r"heard|hears?": "received, receives",
    r"says?|said": "states, contains, has",
    r"tells?|told": "published, reported",
    r"refus(es?|ed|al|als|ing)": "reject",
    r"of its own accord": "(state the cause)",
    r"for so long|so long(?! as)": "for this time",
    r"for good": "permanently",
    r"whoever|whomever": "a client that, everyone who",
    r"comes? about": "happens",
    r"not at all": "not, none",
    r"goes_on|only_meant": "is_alive, explicit_only",
    r"desks?": "request reader",
    r"settle[sd]?": "completed",
    r"in step(?! with)": "synchronised",
    r"beside": "next to, while, in the same folder",
    r"as it is(?! (commanded|given|written))": "unchanged, current",
    r"whom": "(name the client)",
    r"so (many|much)(?!.{0,60}\bthat\b)": "(the number)",
    r"(is|are) what .{1,30} (does|do)|what .{1,30} is so": "(subject, verb, object)",
    r"ha(s|ve) (it|the robot) (sit|stand|walk|lie|stop|land)": "makes the robot sit …",
    r"takes nothing": "accepts nothing",
}
"""The words, and what stands in their place."""
ANY: Final = re.compile("|".join(rf"(?<![\w.])(?:{word})(?![\w=(])" for word in INSTEAD), re.IGNORECASE)
IN_PAGE: Final = re.compile(
    r"/\*.*?\*/|//[^\n]*|\"[A-Z][^\"\n]* [^\"\n]*\"|`[A-Z][^`]* [^`]*`|>[^<>{}();=]+<", re.DOTALL
)
"""Comments of JavaScript, its sentences, and the text of HTML."""
NO_PROSE: Final = re.compile(
    r"`[^`\n]*`|\$?\{[^{}]*\}|@param.*|.*=> void.*|refused.(css|html)|connection refused", re.IGNORECASE
)
"""Code within these, types of parameters, and names that others gave."""


def prose(path: Path) -> Iterator[tuple[int, str]]:
    """Yield each line of a page, or of the comments and texts of a program; without code that stands in them."""
    text = path.read_text()
    if path.suffix == ".md":
        texts = [(1, text)]
    elif path.suffix == ".py":
        kinds = {tokenize.COMMENT, tokenize.STRING, getattr(tokenize, "FSTRING_MIDDLE", tokenize.STRING)}
        tokens = tokenize.generate_tokens(io.StringIO(text).readline)
        texts = [(token.start[0], token.string) for token in tokens if token.type in kinds]
    else:
        texts = [(text.count("\n", 0, hit.start()) + 1, hit[0]) for hit in IN_PAGE.finditer(text)]
    for first, found in texts:
        yield from enumerate(NO_PROSE.sub(lambda code: "\n" * code[0].count("\n"), found).splitlines(), first)


def found(path: Path) -> list[str]:
    """Return where one of the words stands."""
    return [
        f"{path}:{number}: {hit[0]} ({instead}): {line.strip()}"
        for number, line in prose(path)
        if ANY.search(line)
        for word, instead in INSTEAD.items()
        for hit in re.finditer(rf"(?<![\w.])(?:{word})(?![\w=(])", line, re.IGNORECASE)
    ]


@pytest.mark.parametrize("paths", [PAGES, CODE, PAGE], ids=["docs", "code", "page"])
def test_no_word_of_the_old_list_is_used(paths: list[Path]) -> None:
    assert not [hit for path in paths for hit in found(path)]


def test_a_word_of_the_list_is_found_in_a_comment_and_in_a_message(tmp_path: Path) -> None:
    one = tmp_path / "one.py"
    one.write_text('said = heard()  # it hears\nprint(f"{said} was told")\n')
    assert [hit.partition(": ")[2][:4] for hit in found(one)] == ["hear", "told"]
