"""Ten clients that want the lease, as a process of its own: each asks to acquire it, and releases what it has not got.

    python -m tests.benchmarks.lease_flood ENDPOINT --hz 1000

It prints `ready` once all are connected. Then each line on its standard input is a number of seconds; it answers
`done COUNT ANSWERED`.
"""

import argparse
import json
import sys
import threading
import time

import zenoh

from gateway.zenoh_config import client_config
from schemas.keys import LEASE

CLIENTS = 10


class Asker:
    """One client, on a thread of its own."""

    def __init__(self, session: zenoh.Session, name: str, hz: float) -> None:
        self._session = session
        self._pause_s = 1 / hz
        release = json.dumps({"do": "release", "lease": "0" * 32})
        self._requests = (json.dumps({"do": "acquire", "source": name}), release)
        self.asked = self.answered = 0

    def run(self, duration_s: float) -> None:
        """Ask for that long, whether the last question is answered or not."""
        due_s = time.monotonic()
        end_s = due_s + duration_s
        while due_s < end_s:
            time.sleep(max(0.0, due_s - time.monotonic()))
            self._session.get(LEASE, self._heard, payload=self._requests[self.asked % 2], timeout=2)
            self.asked += 1
            due_s += self._pause_s

    def _heard(self, reply: zenoh.Reply) -> None:
        self.answered += reply.ok is not None


def main() -> None:
    """Ask whenever a line comes."""
    parser = argparse.ArgumentParser(description="Want the lease, again and again.")
    parser.add_argument("endpoint")
    parser.add_argument("--hz", type=float, required=True, help="requests a second, of all clients together")
    options = parser.parse_args()
    sessions = [zenoh.open(client_config(options.endpoint)) for _ in range(CLIENTS)]
    askers = [
        Asker(session, f"client {number}", options.hz / CLIENTS) for number, session in enumerate(sessions, start=1)
    ]
    print("ready", flush=True)
    for line in sys.stdin:
        for asker in askers:
            asker.asked = asker.answered = 0
        threads = [threading.Thread(target=asker.run, args=(float(line),)) for asker in askers]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        time.sleep(0.5)  # the last answers
        print("done", sum(a.asked for a in askers), sum(a.answered for a in askers), flush=True)
    for session in sessions:
        session.close()


if __name__ == "__main__":
    main()
