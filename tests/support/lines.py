"""Scenes as text that a device's fake plays: each line is what is done, what came of it, and what is then so.

    wait 1100; move → m
    fail 1; stop → 123456 6 5 …; fault 123456 failed

What came of it is words; `nothing`: none, `…`: any further ones. A fault that no fact names fails the scene. Two spaces
and a `#` begin a comment.
"""

from collections.abc import Callable, Mapping
from typing import Final, TypeVar

T = TypeVar("T")
FAULT: Final = "fault"
"""The fact that a text contains; of the other facts, the text is equal."""


def play(
    subject: T,
    scene: str,
    done: Mapping[str, Callable[[T, str], object]],
    made: Callable[[T], list[str]],
    facts: Mapping[str, Callable[[T], object]],
) -> T:
    """Take each line of it. `made`: the words since it was last asked."""
    for line in filter(None, map(str.strip, scene.splitlines())):
        actions, arrow, expected = line.partition("  #")[0].partition("→")
        for each in actions.split(";"):
            word, _, rest = each.strip().partition(" ")
            done[word](subject, rest)
        if not arrow:
            continue
        wanted, *others = (each.strip() for each in expected.split(";"))
        words, more, _ = wanted.replace("nothing", "").partition("…")
        found = made(subject)
        assert (found[: len(words.split())] if more else found) == words.split(), f"{line}: {found}"
        for fact in others if any(each.startswith(FAULT) for each in others) else (*others, f"{FAULT} None"):
            word, _, text = fact.partition(" ")
            is_so = str(facts[word](subject))
            assert text in is_so if word == FAULT else text == is_so, f"{line}: {fact}, but {is_so}"
    return subject
