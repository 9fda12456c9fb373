"""A laptop that opens a session again and again, and presses the emergency stop in each: `FILE SECONDS`.

It prints a line for each attempt.
"""

import sys
import time
from contextlib import suppress
from pathlib import Path

import zenoh

from gateway.zenoh_config import load_config
from schemas.keys import ESTOP


def main(file: str, pause_s: float) -> None:
    """Until it is ended."""
    while True:
        config = load_config(Path(file))
        config.insert_json5("connect/timeout_ms", "500")
        with suppress(zenoh.ZError):
            session = zenoh.open(config)
            session.put(ESTOP, b"")
            session.close()
        print("tried", flush=True)
        time.sleep(pause_s)


if __name__ == "__main__":
    main(sys.argv[1], float(sys.argv[2]))
