"""An object in a process of its own, whose methods a test calls by lines on its standard input.

A line is a JSON list, [name, arguments, named arguments]; it is answered by one: {"ok": value} or {"error": words}.
"""

import json
import sys
from typing import Final

READY: Final = "the peer is ready"


def act(actor: object) -> None:
    """Do what stdin says, until it ends."""
    print(READY, flush=True)
    for line in sys.stdin:
        name, arguments, named = json.loads(line)
        try:
            answer = {"ok": getattr(actor, name)(*arguments, **named)}
        except Exception as error:
            answer = {"error": f"{type(error).__name__}: {error}"}
        print(json.dumps(answer), flush=True)
