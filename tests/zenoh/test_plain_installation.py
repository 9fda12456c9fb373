"""What a plain installation can import: the extras' packages are missing there, and a developer's machine has all."""

import json
import re
import subprocess
import sys
import tomllib
from importlib.metadata import PackageNotFoundError, packages_distributions, requires
from pathlib import Path
from typing import Final

PROJECT: Final = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"]
NEED_AN_EXTRA: Final = {
    **{f"gateway.people.ros2.{name}": "rclpy" for name in ("follow_action", "node", "reports", "run", "topics")},
    "gateway.people.console": "console",
    "gateway.people.physics": "physics",
    "gateway.people.recorder.record": "record",
    "gateway.onboard.simulation_process": "physics",
    "gateway.robot.power.slcan": "power",
}
"""Modules that other modules load only where a person asks for what the extra is for."""

IMPORT_ALL: Final = """
import importlib.machinery, json, pkgutil, sys
blocked = set(json.loads(sys.argv[1]))
class Installed(importlib.machinery.PathFinder):
    @classmethod
    def find_spec(cls, name, path=None, target=None):
        return None if name.partition(".")[0] in blocked else super().find_spec(name, path, target)
sys.meta_path[sys.meta_path.index(importlib.machinery.PathFinder)] = Installed
import gateway
failed = []
for module in pkgutil.walk_packages(gateway.__path__, "gateway.", onerror=lambda name: None):
    if not module.name.endswith("__main__"):
        try:
            importlib.import_module(module.name)
        except Exception:
            failed.append(module.name)
print(json.dumps(failed))
"""


def _name(requirement: str) -> str:
    found = re.match(r"[A-Za-z0-9._-]+", requirement)
    assert found is not None, requirement
    return re.sub(r"[._-]+", "-", found[0]).lower()


def _with_theirs(names: set[str]) -> set[str]:
    """These distributions and all that they need."""
    found: set[str] = set()
    pending = set(names)
    while pending:
        found.add(name := pending.pop())
        try:
            needed = requires(name) or []
        except PackageNotFoundError:
            continue
        pending |= {_name(each) for each in needed if "extra ==" not in each} - found
    return found


def test_a_plain_installation_imports_all_but_what_an_extra_is_for() -> None:
    plain = _with_theirs({_name(each) for each in PROJECT["dependencies"]})
    blocked = [
        module
        for module, distributions in packages_distributions().items()
        if not {re.sub(r"[._-]+", "-", each).lower() for each in distributions} & (plain | {_name(PROJECT["name"])})
        and module not in sys.stdlib_module_names
    ]
    ran = subprocess.run(
        [sys.executable, "-c", IMPORT_ALL, json.dumps(blocked)], capture_output=True, text=True, check=True
    )
    failed = [name for name in json.loads(ran.stdout) if not name.startswith(tuple(NEED_AN_EXTRA))]
    assert failed == []
