"""What else may reach a gateway, without end: the lawful, the wrong, the silent, the sudden. One line a round.

python -m tests.benchmarks.soak_traffic ENDPOINT
"""

import itertools
import json
import sys
import time

from gateway.client import Client, leg_payload, servo_payload
from schemas.keys import LEGS_COMMAND, leg_command, servo_command

ROUND_S = 1.0
FLOOD = 10_000  # messages in one go

WRONG: tuple[tuple[str, str | bytes], ...] = (
    (leg_command(5), ""),
    (leg_command(5), b"\xff\xfe\x00"),
    (leg_command(5), "[" * 4000),
    (leg_command(5), "x" * 5000),
    (leg_command(5), '{"servos":[{"op":"set","angle_deg":181},{"op":"stop"},{"op":"stop"}]}'),
    (leg_command(5), '{"servos":[],"colour":"red"}'),
    (servo_command(51), '{"op":"set","angle_deg":"90"}'),
    (LEGS_COMMAND, '{"legs":{"7":{"servos":[]}}}'),
    ("hexapod/leg/7/cmd", "{}"),
    ("hexapod/servo/14/cmd", "{}"),
    ("hexapod/nonsense/cmd", "{}"),
)


def one_round(client: Client, number: int) -> None:
    """A second's worth; leg 5 falls silent at its end, so its watchdog has work."""

    session = client.session

    def put(key: str, payload: object) -> None:
        session.put(key, json.dumps({"source": f"traffic-{number % 7}", **payload}))  # type: ignore[dict-item]

    for step in range(20):
        put(leg_command(5), leg_payload("start", (10.0 + step, 20.0, 30.0)))
        put(servo_command(51), servo_payload("set", 40.0 + step))
        time.sleep(0.005)
    put(servo_command(52), servo_payload("stop"))
    put(LEGS_COMMAND, {"legs": {"4": leg_payload("set", (1, 2, 3)), "5": leg_payload("set", (4, 5, 6))}})
    for key, payload in WRONG:
        session.put(key, payload)
    session.put(leg_command(5), "{}", encoding="text/plain")
    session.delete(leg_command(5))
    if number % 5 == 0:
        put("hexapod/leg/*/cmd", leg_payload("stop"))
    if number % 10 == 3:
        client.reset(client.estop().estop, check=False)
    if number % 15 == 7:
        flood = json.dumps(leg_payload("start", (90.0, 90.0, 90.0)))
        for _ in range(FLOOD):
            session.put(leg_command(1), flood)


def main() -> None:
    """Go on until killed; every other round a client connects, asks and leaves."""
    endpoint = sys.argv[1]
    with Client(endpoint, source="traffic", timeout_s=5) as client:
        for number in itertools.count():
            begun_s = time.monotonic()
            one_round(client, number)
            if number % 2 == 0:
                with Client(endpoint, source=f"visitor-{number}", timeout_s=5) as visitor:
                    visitor.state()
                    visitor.set_leg(3, 90, 90, 90, check=False)
            print(number, flush=True)
            time.sleep(max(0.0, begun_s + ROUND_S - time.monotonic()))


if __name__ == "__main__":
    main()
