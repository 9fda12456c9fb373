"""The yardstick of the benchmark: what one would write in ten minutes. It checks nothing, and never stops a servo."""

import json
import signal
import sys
from typing import Any

import spidev
import zenoh

ANNOUNCES = sys.argv[2:] == ["length-prefixed"]
OPS: dict[object, int] = {"start": 1, "stop": 2, "set": 3}
spi = spidev.SpiDev()
spi.open(0, 0)
spi.max_speed_hz = 2_500_000


def write(leg: int, servos: list[dict[str, Any]]) -> None:
    frame = [14, 1]
    for joint, servo in enumerate(servos, start=1):
        angle = servo.get("angle_deg", 0)
        frame += [leg * 10 + joint, OPS[servo["op"]], int(angle), round(angle % 1 * 100)]
    if ANNOUNCES:
        spi.writebytes2(frame[:1])
    spi.writebytes2(frame)


def on_command(sample: zenoh.Sample) -> None:
    write(int(str(sample.key_expr).split("/")[2]), json.loads(sample.payload.to_bytes())["servos"])


def on_legs(sample: zenoh.Sample) -> None:
    for leg, command in json.loads(sample.payload.to_bytes())["legs"].items():
        write(int(leg), command["servos"])


config = zenoh.Config()
config.insert_json5("listen/endpoints", json.dumps([sys.argv[1]]))
config.insert_json5("scouting/multicast/enabled", "false")
with zenoh.open(config) as session:
    session.declare_subscriber("hexapod/leg/*/cmd", on_command)
    session.declare_subscriber("hexapod/legs/cmd", on_legs)
    print("ready", flush=True)
    signal.pause()
