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

from tests.support.console_process import Page, sign_in

PAUSE_S = 0.05


def main() -> None:
    """Until the standard input ends."""
    link, authority = sys.argv[1:]
    context = ssl.create_default_context(cafile=authority)
    session = sign_in(link, context)
    with Page(link.partition("/?")[0], session, verify=context) as page:
        print("signed in", json.dumps(session), flush=True)
        for line in sys.stdin:
            took_ms = []
            for _ in range(int(line)):
                page.send(type="alive", now_ms=page.now_ms())
                began_s = time.perf_counter()
                page.stop_all()
                took_ms.append(round((time.perf_counter() - began_s) * 1000, 1))
                threading.Event().wait(PAUSE_S)
            print(json.dumps(took_ms), flush=True)


if __name__ == "__main__":
    main()
