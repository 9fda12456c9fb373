"""`control_msgs` for rclpy, which no package index of Python has: made by ROS 2's own generators, and g++.

`python -m tests.support.control_msgs FOLDER`, by the Python that has rclpy, makes the package in that folder.
"""

import json
import os
import shutil
import subprocess
import sys
import sysconfig
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any, Final

from tests.support.rclpy_peer import PYTHON, ROOT

NAME: Final = "control_msgs"
RCLPY: Final = Path(PYTHON).parents[1]
_TOLERANCE: Final = "float64 position\nfloat64 velocity\nfloat64 acceleration"
_STATE: Final = "trajectory_msgs/JointTrajectoryPoint"
_MULTI: Final = "trajectory_msgs/MultiDOFJointTrajectoryPoint"
DEFINITIONS: Final = {
    "msg/JointTolerance": f"string name\n{_TOLERANCE}",
    "msg/JointComponentTolerance": f"string joint_name\nuint16 component\n{_TOLERANCE}",
    "action/FollowJointTrajectory": f"""
        trajectory_msgs/JointTrajectory trajectory
        trajectory_msgs/MultiDOFJointTrajectory multi_dof_trajectory
        control_msgs/JointTolerance[] path_tolerance
        control_msgs/JointComponentTolerance[] component_path_tolerance
        control_msgs/JointTolerance[] goal_tolerance
        control_msgs/JointComponentTolerance[] component_goal_tolerance
        builtin_interfaces/Duration goal_time_tolerance
        ---
        int32 SUCCESSFUL=0
        int32 INVALID_GOAL=-1
        int32 INVALID_JOINTS=-2
        int32 OLD_HEADER_TIMESTAMP=-3
        int32 PATH_TOLERANCE_VIOLATED=-4
        int32 GOAL_TOLERANCE_VIOLATED=-5
        int32 error_code
        string error_string
        ---
        std_msgs/Header header
        string[] joint_names
        {_STATE} desired
        {_STATE} actual
        {_STATE} error
        string[] multi_dof_joint_names
        {_MULTI} multi_dof_desired
        {_MULTI} multi_dof_actual
        {_MULTI} multi_dof_error""",
}
"""As control_msgs 4 and 5 (Humble, Jazzy) and 6 up to 6.2 have them."""
DEPENDENCIES: Final = (
    "trajectory_msgs",
    "geometry_msgs",
    "std_msgs",
    "builtin_interfaces",
    "unique_identifier_msgs",
    "action_msgs",
    "service_msgs",
)
LIBRARIES: Final = {
    "rosidl_generator_c": ("rosidl_runtime_c", "rcutils"),
    "rosidl_typesupport_fastrtps_cpp": ("rosidl_typesupport_fastrtps_cpp", "fastcdr", "rmw", "rosidl_runtime_c"),
    "rosidl_typesupport_fastrtps_c": ("rosidl_typesupport_fastrtps_c", "fastcdr", "rmw", "rosidl_runtime_c"),
    "rosidl_typesupport_c": ("rosidl_typesupport_c", "rosidl_runtime_c"),
    "rosidl_generator_py": ("rosidl_typesupport_c", "rosidl_runtime_c", "rcutils"),
}
"""What each generator's library is linked with, besides those before it and those of `DEPENDENCIES`."""


def made(folder: Path) -> dict[str, str]:
    """Make the package; returns its environment."""
    own = {"PYTHONPATH": f"{folder / 'made'}:{ROOT}", "LD_LIBRARY_PATH": str(folder / "made")}
    making = [PYTHON, "-m", "tests.support.control_msgs", str(folder)]
    done = subprocess.run(making, env=os.environ | own, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(done.stderr[-4000:])
    return own


def _make(folder: Path) -> None:
    adapter: Any = import_module("rosidl_adapter")
    kinds = {}
    for name, text in DEFINITIONS.items():
        kind = name.partition("/")[0]
        file = folder / f"{name}.{kind}"
        file.parent.mkdir(exist_ok=True)
        file.write_text("".join(f"{line.strip()}\n" for line in text.splitlines()))
        adapter.convert_to_idl(folder, NAME, file.relative_to(folder), folder / "idl")
        kinds[f"{name}.idl"] = f"{name}.json"
    _generate(folder, kinds)
    (folder / "made").mkdir()
    before: list[str] = []
    for generator in LIBRARIES:
        is_python = generator == "rosidl_generator_py"
        found = sorted((*(folder / generator).rglob("*.c"), *(folder / generator).rglob("*.cpp")))
        sources = [each for each in found if not is_python or "_s." in each.name]
        target = folder / "made" / f"lib{NAME}__{generator}.so"
        if is_python:
            shutil.copytree(folder / generator / NAME, folder / "made" / NAME)
            suffix = sysconfig.get_config_var("EXT_SUFFIX")
            target = folder / "made" / NAME / f"{NAME}_s__rosidl_typesupport_c{suffix}"
        _compile(folder, target, sources, [*before, *_libraries(generator)])
        before.insert(0, f"{NAME}__{generator}")


def _generate(folder: Path, kinds: dict[str, str]) -> None:
    """Sources, by each generator."""
    idls = [f"{folder / 'idl'}:{idl}" for idl in kinds]
    described = [f"{idl}:{folder / 'rosidl_generator_type_description' / NAME / found}" for idl, found in kinds.items()]

    def arguments(generator: str) -> str:
        output = folder / generator / NAME
        output.mkdir(parents=True)
        templates = RCLPY / "share" / generator / "resource"
        for each in templates.glob("*.in"):
            text = each.read_text().replace("@PROJECT_NAME@", NAME).replace("@PROJECT_NAME_UPPER@", NAME.upper())
            (output / "msg").mkdir(exist_ok=True)
            (output / "msg" / each.stem).write_text(text)
        found = {
            "package_name": NAME,
            "output_dir": str(output),
            "template_dir": str(templates),
            "idl_tuples": idls,
            "ros_interface_dependencies": [],
            "target_dependencies": [],
            "type_description_tuples": described,
            "include_paths": [f"{each}:{RCLPY / 'share' / each}" for each in DEPENDENCIES],
        }
        path = folder / f"{generator}.json"
        path.write_text(json.dumps(found))
        return str(path)

    def call(generator: str, function: str, *more: Any, module: str = "") -> None:
        found: Any = import_module(f"{generator}{module}")
        getattr(found, function)(arguments(generator), *more)

    call("rosidl_generator_type_description", "generate_type_hash")
    call("rosidl_generator_c", "generate_c")
    call("rosidl_generator_cpp", "generate_cpp")
    call("rosidl_typesupport_fastrtps_c", "generate_typesupport_fastrtps_c")
    call("rosidl_typesupport_fastrtps_cpp", "generate_cpp")
    call("rosidl_typesupport_c", "generate_c", ["rosidl_typesupport_fastrtps_c"])
    call("rosidl_generator_py", "generate_py", ["rosidl_typesupport_c"], module=".generate_py_impl")


def _libraries(generator: str) -> Iterator[str]:
    kinds = (generator, "rosidl_generator_c") if "cpp" not in generator else (generator,)
    for kind in kinds:
        for package in DEPENDENCIES:
            if (RCLPY / "lib" / f"lib{package}__{kind}.so").exists():
                yield f"{package}__{kind}"
    yield from LIBRARIES[generator]


def _compile(folder: Path, target: Path, sources: list[Path], libraries: list[str]) -> None:
    numpy: Any = import_module("numpy")
    includes = [
        *(folder / generator for generator in (*LIBRARIES, "rosidl_generator_cpp")),
        RCLPY / "include",
        *(RCLPY / "include").iterdir(),
        numpy.get_include(),
        sysconfig.get_path("include"),
    ]
    flags = ["-O0", "-w", "-fPIC", *(f"-I{each}" for each in includes)]
    objects = []
    for source in sources:
        compiler = ["g++", "-std=c++17"] if source.suffix == ".cpp" else ["gcc"]
        objects.append(str(source.with_suffix(".o")))
        subprocess.run([*compiler, *flags, "-c", str(source), "-o", objects[-1]], check=True)
    places = (RCLPY / "lib", folder / "made")
    paths = [flag for each in places for flag in (f"-L{each}", f"-Wl,-rpath,{each}")]
    linked = ["g++", "-shared", "-o", str(target), *objects, *paths, *(f"-l{each}" for each in libraries)]
    subprocess.run(linked, check=True)


if __name__ == "__main__":
    _make(Path(sys.argv[1]))
