"""Moves a leg with nothing but `eclipse-zenoh`: what a program in any other language would do."""

import argparse
import json
import time

import zenoh


def ask(session: zenoh.Session, key: str, payload: object) -> dict[str, object]:
    """An acknowledged command: a `get` whose answer is an Ack."""
    for reply in session.get(key, payload=json.dumps(payload), encoding="application/json", timeout=2.0):
        if reply.ok is not None:
            return dict(json.loads(reply.ok.payload.to_bytes()))
    raise SystemExit("no gateway answers; is it running?")


def leg(op: str, *angles_deg: float) -> dict[str, object]:
    return {
        "servos": [{"op": op, "angle_deg": angle_deg} for angle_deg in angles_deg],
        "source": "plain zenoh",
        "sent_ms": time.monotonic() * 1000,  # lets the gateway reject what was delayed on the way
    }


def main(endpoint: str) -> None:
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    with zenoh.open(config) as session:
        print("start:", ask(session, "hexapod/leg/3/cmd", leg("start", 90, 90, 90)))
        for step in range(25):  # a stream: fire and forget, at 50 Hz
            command = json.dumps(leg("set", 90, 90 + step, 90 - step))
            session.put("hexapod/leg/3/cmd", command, encoding="application/json", express=True)
            time.sleep(0.02)
        print("stop:", ask(session, "hexapod/leg/3/cmd", {"servos": [{"op": "stop"}] * 3}))


if __name__ == "__main__":
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--connect", default="tcp/127.0.0.1:7447", metavar="ENDPOINT")
    main(arguments.parse_args().connect)
