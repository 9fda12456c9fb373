"""What a message costs in Python calls and in memory: the same on every machine, however busy (`support/calls.py`)."""

import json
import os
import sys
from contextlib import closing
from pathlib import Path

from tests.benchmarks.table import Row
from tests.support.calls import costs
from tests.support.child import Child


def main() -> None:
    """Print both as JSON."""
    print(json.dumps(costs(Path(sys.argv[1]))), flush=True)


def calls(folder: Path) -> list[Row]:
    """The figures, from a process of their own; `tests/zenoh/test_calls.py` holds them."""
    with closing(Child([sys.executable, "-m", "tests.benchmarks.calls", str(folder)], os.environ)) as child:
        child.wait(60)
        found, taken_bytes = json.loads(child.stdout)
    rows = [
        Row(f"Python calls for {name}: to the ioctl, and in all", f"{to_ioctl}, {in_all}", "")
        for name, (to_ioctl, in_all) in found.items()
    ]
    return [*rows, Row("memory taken at a time for a stream's six legs", f"{taken_bytes / 1024:.1f} kB", "")]


if __name__ == "__main__":
    main()
