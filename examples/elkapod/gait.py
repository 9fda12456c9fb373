"""The Elkapod walks: a tripod gait in joint angles that are the same on both sides.

Which servos are mounted the other way round is the calibration's affair, how fast they may go and what happens when
this program falls silent the gateway's: see the files beside this one.
"""

import argparse
import json
import math
import time
from pathlib import Path

from gateway.client import DEFAULT_ENDPOINT, Client, GatewayError

ROBOT = json.loads(Path(__file__).with_name("geometry.json").read_text())
COXA_M, FEMUR_M, TIBIA_M = (ROBOT["link_lengths_m"][link] for link in ("coxa", "femur", "tibia"))
STEP_S, STRIDE_M, LIFT_M = 1.2, 0.06, 0.04
REACH_M, DEPTH_M = 0.20, 0.145  # where a foot rests: outward from the leg's mount, and below its second joint


def angles_deg(leg: int, phase: float) -> tuple[float, float, float]:
    """A leg's joints; phase 0 to 0.5 is the swing, 0.5 to 1 the stance."""
    forward_m = STRIDE_M * (2 * phase - 0.5 if phase < 0.5 else 1.5 - 2 * phase)
    up_m = LIFT_M * max(0.0, math.sin(2 * math.pi * phase))
    yaw = ROBOT["leg_mounts"][str(leg)]["yaw_rad"]
    x, y, z = REACH_M + forward_m * math.cos(yaw), -forward_m * math.sin(yaw), up_m - DEPTH_M
    radial = math.hypot(x, y) - COXA_M
    span = math.hypot(radial, z)
    knee = math.acos((span**2 - FEMUR_M**2 - TIBIA_M**2) / (2 * FEMUR_M * TIBIA_M))
    rise = math.acos((FEMUR_M**2 + span**2 - TIBIA_M**2) / (2 * FEMUR_M * span))
    first, second = math.atan2(y, x), math.atan2(z, radial) + rise
    return 90 + math.degrees(first), 90 + math.degrees(second), math.degrees(knee)


def pose(seconds: float) -> dict[int, tuple[float, float, float]]:
    """All legs at a time: 1, 4 and 5 swing while 2, 3 and 6 stand, then the other way round."""
    return {leg: angles_deg(leg, (seconds / STEP_S + 0.5 * (leg in (2, 3, 6))) % 1) for leg in range(1, 7)}


def main(endpoint: str, seconds: float) -> None:
    with Client(endpoint, source="elkapod gait") as robot, robot.lease(), robot.stream(50) as stream:
        begun_s = time.monotonic()
        while (elapsed_s := time.monotonic() - begun_s) < seconds:
            stream.set(pose(elapsed_s))
    print(f"walked for {seconds:g} s, {stream.missed} ticks missed")


if __name__ == "__main__":
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--connect", default=DEFAULT_ENDPOINT, metavar="ENDPOINT")
    arguments.add_argument("--seconds", type=float, default=60.0)
    given = arguments.parse_args()
    try:
        main(given.connect, given.seconds)
    except GatewayError as error:
        raise SystemExit(str(error)) from None
