"""A terminal's text as a picture for the documents."""

import html
import re
from io import StringIO

from rich.console import Console
from rich.terminal_theme import MONOKAI
from rich.text import Text

_BLANK = "&#160;"


def svg(text: Text, command: str, columns: int, rows: int) -> str:
    """What `hexapod-gateway COMMAND` shows, in a terminal of this size."""
    console = Console(record=True, file=StringIO(), width=columns, height=rows, force_terminal=True)
    console.print(text)
    drawn = console.export_svg(title=f"hexapod-gateway {command}", theme=MONOKAI, unique_id=command)
    return _without_edge_blanks(drawn, command)


def _without_edge_blanks(drawn: str, name: str) -> str:
    """Each text begins and ends with a character that is seen: not every program keeps blanks at the edges."""

    def narrow(found: re.Match[str]) -> str:
        before, x, between, length, after, text = found.groups()
        content = text.replace(_BLANK, " ")
        bare = content.strip(" ")
        column = float(length) / len(html.unescape(content))
        x = float(x) + column * (len(content) - len(content.lstrip(" ")))
        length = column * len(html.unescape(bare))
        return f"{before}{x:g}{between}{length:g}{after}{bare.replace(' ', _BLANK)}</text>" if bare else ""

    place = rf'(<text class="{name}-r\d+" x=")([\d.]+)(" y="[\d.]+" textLength=")([\d.]+)("[^>]*>)([^<]+)</text>'
    return re.sub(place, narrow, drawn)
