"""A publisher that outlives many gateways: they dial it, and each hears starts for all six legs, without a pause.

    python -m tests.hil.starter tcp/127.0.0.1:PORT

It says when it listens, and goes on until it is ended.
"""

import itertools
import json
import sys
import time

import zenoh

from gateway.client import leg_payload
from schemas.keys import leg_command

PERIOD_S = 0.01  # its own rhythm: 100 Hz for each leg


def main() -> None:
    config = zenoh.Config()
    config.insert_json5("mode", '"peer"')
    config.insert_json5("listen/endpoints", json.dumps(sys.argv[1:]))
    for scouting in ("scouting/multicast/enabled", "scouting/gossip/enabled"):
        config.insert_json5(scouting, "false")
    with zenoh.open(config) as session:
        print("listening", flush=True)
        for step in itertools.count():
            for leg in range(1, 7):
                angle_deg = 60 + (step * leg) % 6000 / 100
                session.put(leg_command(leg), json.dumps(leg_payload("start", (angle_deg, 90, 180 - angle_deg))))
            time.sleep(PERIOD_S)


if __name__ == "__main__":
    main()
