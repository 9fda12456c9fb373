"""A page that is signed in, on another machine: signs in by a link, and presses STOP ALL whenever it is asked to.

    python -m tests.attack.presses LINK CA_FILE

It prints `signed in`, and for each line on its standard input, a number of presses, one line of JSON: how long each
took from the page's message until the gateway had confirmed it, in ms.
"""

import json
import ssl
import sys
import threading
import time
from queue import SimpleQueue

from tests.support.console_process import Page, sign_in

PAUSE_S = 0.05


def read(lines: "SimpleQueue[str]") -> None:
    """Until the standard input ends."""
    for line in sys.stdin:
        lines.put(line)


def main() -> None:
    """Never ends."""
    link, authority = sys.argv[1:]
    context = ssl.create_default_context(cafile=authority)
    session = sign_in(link, context)
    with Page(link.partition("/?")[0], session, verify=context) as page:
        print("signed in", json.dumps(session), flush=True)
        lines: SimpleQueue[str] = SimpleQueue()
        threading.Thread(target=read, args=(lines,), daemon=True).start()
        while True:
            while lines.empty():
                page.state()  # a page that reads nothing would be given up
            took_ms = []
            for _ in range(int(lines.get())):
                page.send(type="alive", now_ms=page.now_ms())
                began_s = time.perf_counter()
                page.stop_all()
                took_ms.append(round((time.perf_counter() - began_s) * 1000, 1))
                threading.Event().wait(PAUSE_S)
            print(json.dumps(took_ms), flush=True)


if __name__ == "__main__":
    main()
