"""The files with the JSON Schemas are what the models make, and a laptop needs only pydantic to make a payload."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import schemas
from schemas.__main__ import documents


def test_the_files_are_what_the_models_make() -> None:
    ran = subprocess.run([sys.executable, "-m", "schemas", "--check"], capture_output=True, text=True, check=False)
    assert (ran.returncode, ran.stdout, ran.stderr) == (0, "", "")


@pytest.fixture
def copied(tmp_path: Path) -> Path:
    """The package, where it may be changed."""
    shutil.copytree(Path(schemas.__file__).parent, tmp_path / "schemas")
    return tmp_path


def check(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    # `-m` finds what stands in the working directory before what is installed.
    command = [sys.executable, "-m", "schemas", *arguments]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)


def test_check_names_each_file_that_is_changed_missing_or_foreign_and_writing_mends_it(copied: Path) -> None:
    command, folder = copied / "schemas" / "command.py", copied / "schemas" / "json"
    command.write_text(command.read_text().replace("le=180.0", "le=181.0"))
    (folder / "Ack.json").unlink()
    (folder / "Other.json").write_text("{}")
    ran = check(copied, "--check")
    assert ran.returncode == 1
    assert ran.stderr.splitlines() == [
        f"schemas/json/{name}.json is out of date; run `python -m schemas`"
        for name in ("Ack", "CalibrationCommand", "LegCommand", "LegsCommand", "Other", "ServoCommand")
    ]
    assert check(copied).returncode == 0
    assert {path.name for path in folder.iterdir()} == documents().keys()
    assert '"maximum": 181.0' in (folder / "LegCommand.json").read_text()
    assert check(copied, "--check").returncode == 0


def test_schemas_import_nothing_but_pydantic_and_the_standard_library() -> None:
    """A laptop that only publishes needs no SPI package and no compiler, and not Zenoh either to make a payload."""
    code = (
        "import sys, importlib, pkgutil\n"
        "import pydantic\n"
        "before = set(sys.modules)\n"
        "import schemas\n"
        "for module in pkgutil.iter_modules(schemas.__path__, 'schemas.'):\n"
        "    importlib.import_module(module.name)\n"
        "roots = {name.partition('.')[0] for name in set(sys.modules) - before}\n"
        "print(*sorted(roots - sys.stdlib_module_names))\n"
    )
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    # The standard library's own configuration is named after the machine. The last four are parts of pydantic.
    imported = {name for name in ran.stdout.split() if not name.startswith("_sysconfigdata_")}
    assert imported <= {"schemas", "pydantic", "pydantic_core", "annotated_types", "typing_inspection"}
