"""Opens a recording or an incident in Rerun: the robot in 3D with its servos that are off, its joints, its log.

It needs `pip install rerun-sdk` as well as hexapod-gateway. `--save FILE.rrd` makes a file of it, for `rerun FILE.rrd`.
"""

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from mcap.reader import make_reader
from rosbags.typesys import Stores, get_typestore

from gateway.geometry import load
from gateway.people.recorder.drawing import CAMERAS, JOINT_COMMANDS, LOG, SERVOS_OFF, SIM_JOINT_STATES, WORLD
from gateway.people.ros2.messages import SPHERE, MarkerArray

TIMELINE: Final = "message_log_time"
MARKS: Final = "/off"


def blueprint(robot: str, cameras: list[str], *, is_simulated: bool) -> rrb.Blueprint:
    """Where each part of a recording is shown.

    `robot`: its URDF's name, under which Rerun puts its links. `cameras`: their topics.
    """
    solid = f"/{robot}/visual_geometries"
    shown = rrb.Spatial3DView(
        name="The robot; red: servos that are off",
        contents=["+ /tf", f"+ {solid}/**", f"+ {MARKS}/**"],
        spatial_information=rrb.SpatialInformation(WORLD if is_simulated else "base"),
        eye_controls=rrb.EyeControls3D(
            position=(0.7, -0.9, 0.7), look_target=(0, 0, 0), eye_up=(0, 0, 1), tracking_entity=f"{solid}/base/visual_0"
        ),
    )
    joints = [rrb.TimeSeriesView(name="Commands (rad); a gap: the servo is off", origin=f"{JOINT_COMMANDS}/position")]
    if is_simulated:
        joints.append(rrb.TimeSeriesView(name="Where the joints are", origin=f"{SIM_JOINT_STATES}/position"))
    seen = [rrb.Spatial2DView(name=each, origin=each) for each in cameras]
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(shown, rrb.TextLogView(name="What happened", origin=LOG), row_shares=[3, 1]),
            rrb.Vertical(*seen, *joints),
        ),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE),
        auto_views=False,
    )


def marks(path: Path) -> Iterator[tuple[int, Any]]:
    """When servos went off or on (ns since 1970), and the marks from then on: Rerun does not draw ROS 2's markers."""
    store = get_typestore(Stores.ROS2_JAZZY)
    with path.open("rb") as file:
        for _, _, message in make_reader(file).iter_messages([SERVOS_OFF]):
            yield message.log_time, store.deserialize_cdr(message.data, MarkerArray.TYPE)


def draw_marks(path: Path) -> None:
    """Each on the frame of its joint."""
    seen: set[int] = set()
    for time_ns, array in marks(path):
        rr.set_time(TIMELINE, timestamp=np.datetime64(time_ns, "ns"))
        off = {mark.id: mark for mark in array.markers if mark.type == SPHERE}
        for servo_id in seen - off.keys():
            rr.log(f"{MARKS}/{servo_id}", rr.Ellipsoids3D.cleared())
        for servo_id, mark in off.items():
            colour = [round(255 * part) for part in (mark.color.r, mark.color.g, mark.color.b)]
            sphere = rr.Ellipsoids3D(radii=[mark.scale.x / 2], colors=[colour], fill_mode="solid")
            rr.log(f"{MARKS}/{servo_id}", rr.CoordinateFrame(mark.header.frame_id), sphere)
        seen |= off.keys()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path, metavar="FILE.mcap")
    parser.add_argument("--save", type=Path, metavar="FILE.rrd")
    parser.add_argument("--geometry", type=Path, metavar="FILE.json", help="of another robot, as the recorder had it")
    arguments = parser.parse_args()
    with arguments.file.open("rb") as file:
        summary = make_reader(file).get_summary()
    counts = summary.statistics.channel_message_counts if summary and summary.statistics else {}
    channels = summary.channels if summary else {}
    simulated = any(channels[number].topic == SIM_JOINT_STATES and count for number, count in counts.items())
    rr.init("hexapod")
    cameras = [each.topic for each in channels.values() if each.topic.startswith(CAMERAS)]
    view = blueprint(load(arguments.geometry).name, cameras, is_simulated=simulated)
    if arguments.save:
        rr.save(arguments.save, default_blueprint=view)
    else:
        rr.spawn(default_blueprint=view)
    rr.log_file_from_path(arguments.file)
    draw_marks(arguments.file)


if __name__ == "__main__":
    main()
