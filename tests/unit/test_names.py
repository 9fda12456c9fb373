"""A class name means one thing in the gateway and the schemas."""

import ast
from collections import defaultdict
from collections.abc import Iterable
from pathlib import Path

import gateway
import schemas

HOMES = tuple(Path(str(package.__file__)).parent for package in (gateway, schemas))


def classes(path: Path) -> Iterable[str]:
    """Names of the classes of a file, nested ones too."""
    return [node.name for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.ClassDef)]


def doubles(homes: Iterable[Path]) -> dict[str, list[Path]]:
    """Names of several classes, and the files of each."""
    files: defaultdict[str, list[Path]] = defaultdict(list)
    for path in sorted(path for home in homes for path in home.rglob("*.py")):
        for name in classes(path):
            files[name].append(path)
    return {name: found for name, found in files.items() if len(found) > 1}


def test_each_class_has_a_name_of_its_own() -> None:
    assert not doubles(HOMES)


def test_a_second_class_of_a_name_is_found(tmp_path: Path) -> None:
    one, other = tmp_path / "one.py", tmp_path / "deep" / "other.py"
    other.parent.mkdir()
    one.write_text("class Lease: ...\nclass Alone: ...\n")
    other.write_text("def made() -> None:\n    class Lease: ...\n")
    assert doubles([tmp_path]) == {"Lease": [other, one]}
