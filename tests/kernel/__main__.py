"""`make kernel`: prepares, boots once for each set of kernel options, prints a table.

python -m tests.kernel                # all scenes; exit code 1: one does not hold
python -m tests.kernel atomic killed  # only these
python -m tests.kernel --arm64        # the package on a machine for arm64
"""

import argparse
import json
import sys
from pathlib import Path
from typing import Any, Final

from tests.kernel import arm64
from tests.kernel.inside.scenes import ALL, ARM64, SCENES
from tests.kernel.machine import Parts, PartsError, boot, prepare


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.kernel", description="The gateway on a real spidev.")
    parser.add_argument("scenes", nargs="*", choices=[*ALL, []], metavar="scene", help=", ".join(ALL))
    parser.add_argument("--arm64", action="store_true", help="on an emulated arm64 with a Debian and our package")
    arguments = parser.parse_args()
    chosen: list[str] = arguments.scenes or list(ARM64 if arguments.arm64 else SCENES)
    try:
        print("QEMU, Debian's kernel and the module (the first time, 100 MB are downloaded)", flush=True)
        parts = arm64.prepare() if arguments.arm64 else prepare()
        found = _play(parts, chosen)
    except PartsError as error:
        print(f"\n{error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130
    print(table(found))
    return 0 if all(row["holds"] for row in found) else 1


def _play(parts: Parts, chosen: list[str]) -> list[dict[str, Any]]:
    found: dict[str, dict[str, Any]] = {}
    for options in sorted({ALL[name].options for name in chosen}):
        names = [name for name in chosen if ALL[name].options == options]

        def look(out: Path) -> None:
            path = out / "scenes"
            lines = path.read_text().splitlines() if path.exists() else []
            for row in map(json.loads, lines):
                if row["scene"] not in found:
                    found[row["scene"]] = row
                    print(f"{len(found)} of {len(chosen)} scenes: {row['scene']}", flush=True)

        boot(parts, " ".join(names), options, look)
    nothing: Final = {"holds": False, "found": f"it was not played to its end; see {parts.cache}/out/output"}
    return [found.get(name, {"scene": name, **nothing}) for name in chosen]


def table(found: list[dict[str, Any]]) -> str:
    """A line for each scene, and what it found below."""
    lines = []
    for row in found:
        lines += [f"{'✓' if row['holds'] else '✗'} {ALL[row['scene']].shows}", f"    {row['found']}"]
    return "\n".join([*lines, f"{sum(row['holds'] for row in found)} of {len(found)} scenes hold"])


if __name__ == "__main__":
    sys.exit(main())
