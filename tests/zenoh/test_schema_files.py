"""The files with the JSON Schemas are what the models make, and a laptop needs only pydantic to make a payload."""

import subprocess
import sys


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
