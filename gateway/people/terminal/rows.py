"""How a command reports what it looked at: a row each, as soon as it is known, and one sentence at the end."""

from typing import Final

from rich.console import Console
from rich.text import Text

from gateway.text import visible

GOOD: Final = "green"
NOTE: Final = "yellow"
BAD: Final = "bold red"


def row(word: str, style: str, name: str, sentence: str, fix: str = "") -> Text:
    """`word  name  sentence → fix`, in columns. Foreign text may be in the last two."""
    text = Text().append(f"{word:8}", style).append(f" {name:14} ", "bold").append(visible(sentence))
    return text.append(f" → {visible(fix)}", "cyan") if fix else text


def show(text: Text) -> None:
    """On stdout, in colour on a terminal, and never wrapped: a program reads lines."""
    Console(highlight=False, soft_wrap=True).print(text)


def conclude(sentence: str, *, well: bool) -> int:
    """The sentence at the end; the exit code."""
    show(Text(sentence, "bold green" if well else BAD))
    return 0 if well else 1
