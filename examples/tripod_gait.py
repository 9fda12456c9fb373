"""A tripod gait: 18 servos at 50 Hz. Three feet stand and push the body forward while three swing ahead.

Foot paths are made in the body's frame (x forward, y left, z up, metres), turned into joint angles by inverse
kinematics, and into servo degrees by the robot's own conventions. All numbers stand in gateway/geometry/elkapod.json.
"""

import argparse
import json
import math
import time
from typing import Any

from gateway.client import DEFAULT_ENDPOINT, Client, GatewayError, StoppedError, Stream
from gateway.geometry import ELKAPOD

GEOMETRY: dict[str, Any] = json.loads(ELKAPOD.read_text())
COXA_M, FEMUR_M, TIBIA_M = (GEOMETRY["link_lengths_m"][link] for link in ("coxa", "femur", "tibia"))
SHOULDER_M = GEOMETRY["chain"][0]["origin_xyz_m"][2]  # the second joint's height above the leg's mount

RATE_HZ = 50
STEP_S = 1.0  # one swing and one stance
STRIDE_M = 0.06
LIFT_M = 0.04
REACH_M = 0.20  # from the leg's mount outward to its foot
HEIGHT_M = 0.12  # of the mounts above the ground
FIRST_TRIPOD = (1, 4, 5)  # front left, middle right, rear left

Angles = tuple[float, float, float]


def foot_path(phase: float) -> tuple[float, float]:
    """How far forward and how high a foot is, in metres; phase 0 to 0.5 is the swing, 0.5 to 1 the stance."""
    if phase < 0.5:
        swing = phase / 0.5
        return STRIDE_M * (swing - 0.5), LIFT_M * math.sin(math.pi * swing)
    return STRIDE_M * (0.5 - (phase - 0.5) / 0.5), 0.0


def joint_angles(leg: int, forward_m: float, up_m: float) -> Angles:
    """Radians of the joints that put a leg's foot `forward_m` ahead of where it rests and `up_m` above the ground."""
    yaw = GEOMETRY["leg_mounts"][str(leg)]["yaw_rad"]
    # From the body's frame into the leg's, whose x points outward.
    x = REACH_M + forward_m * math.cos(yaw)
    y = -forward_m * math.sin(yaw)
    z = up_m - HEIGHT_M - SHOULDER_M
    radial = math.hypot(x, y) - COXA_M
    span = math.hypot(radial, z)
    knee = math.acos((span**2 - FEMUR_M**2 - TIBIA_M**2) / (2 * FEMUR_M * TIBIA_M))
    rise = math.acos((FEMUR_M**2 + span**2 - TIBIA_M**2) / (2 * FEMUR_M * span))
    return math.atan2(y, x), math.atan2(z, radial) + rise, -knee


def servo_angles(leg: int, joints: Angles) -> Angles:
    """Degrees of a leg's servos, 0 to 180; the servos of the right side turn the other way."""
    first, second, third = map(math.degrees, joints)
    if leg % 2:
        return first + 90, second + 90, -third
    return first + 90, 90 - second, 180 + third


def pose(seconds: float) -> dict[int, Angles]:
    """All servos' angles at a time."""
    phase = seconds / STEP_S % 1
    return {
        leg: servo_angles(leg, joint_angles(leg, *foot_path(phase if leg in FIRST_TRIPOD else (phase + 0.5) % 1)))
        for leg in range(1, 7)
    }


def walk(stream: Stream, seconds: float, start_again: bool) -> None:
    """Set all legs at each tick. What was stopped stays stopped, unless `--start-again` decided otherwise."""
    begun_s = time.monotonic()
    while (elapsed_s := time.monotonic() - begun_s) < seconds:
        try:
            stream.set(pose(elapsed_s))
        except StoppedError as stopped:
            if not start_again:
                raise
            print(f"starting again: {stopped}")
            stream.start_again()


def main(endpoint: str, seconds: float, start_again: bool) -> None:
    with Client(endpoint, source="tripod gait") as robot:
        with robot.lease(), robot.stream(RATE_HZ) as stream:  # nobody else moves it meanwhile
            walk(stream, seconds, start_again)
        counts = robot.state().commands
        print(f"walked for {seconds:g} s, {stream.missed} ticks missed; ", end="")
        print(f"{counts.accepted} commands accepted, {counts.rejected} rejected")


if __name__ == "__main__":
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--connect", default=DEFAULT_ENDPOINT, metavar="ENDPOINT")
    arguments.add_argument("--seconds", type=float, default=10.0)
    arguments.add_argument("--start-again", action="store_true", help="go on by itself when something stopped a leg")
    given = arguments.parse_args()
    try:
        main(given.connect, given.seconds, given.start_again)
    except GatewayError as error:
        raise SystemExit(str(error)) from None
