"""`make kernel`: prepares, boots once for each set of kernel options, prints a table; writes build/kernel/report.json.

python -m tests.kernel                # all scenes; exit code 1: one does not hold
python -m tests.kernel atomic killed  # only these; the report stays as it is
"""

import argparse
import json
import subprocess
import sys
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

from tests.kernel.inside.scenes import SCENES
from tests.kernel.machine import boot
from tests.kernel.parts import ROOT, Parts, PartsError, prepare

REPORT: Final = ROOT / "build" / "kernel" / "report.json"


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.kernel", description="The gateway on a real spidev.")
    parser.add_argument("scenes", nargs="*", choices=[*SCENES, []], metavar="scene", help=", ".join(SCENES))
    chosen: list[str] = parser.parse_args().scenes or list(SCENES)
    progress = Progress()
    try:
        progress.say("QEMU, Debian's kernel and the module (the first time, 100 MB are downloaded)")
        parts = prepare()
        found = _play(parts, chosen, progress)
    except PartsError as error:
        print(f"\n{error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130
    progress.end()
    print(table(found))
    if chosen == list(SCENES):
        REPORT.write_text(json.dumps(_report(parts, found), indent=1, ensure_ascii=False) + "\n")
        print(f"written: {REPORT.relative_to(ROOT)}")
    return 0 if all(row["holds"] for row in found) else 1


def _play(parts: Parts, chosen: list[str], progress: "Progress") -> list[dict[str, Any]]:
    found: dict[str, dict[str, Any]] = {}
    for options in sorted({SCENES[name].options for name in chosen}):
        names = [name for name in chosen if SCENES[name].options == options]

        def look(out: Path, names: list[str] = names) -> None:
            path = out / "scenes"
            lines = path.read_text().splitlines() if path.exists() else []
            found.update({row["scene"]: row for row in map(json.loads, lines)})
            left = [name for name in names if name not in found]
            progress.say(f"{len(found)} of {len(chosen)} scenes; now {left[0] if left else 'powering off'}")

        boot(parts, " ".join(names), options, look)
    nothing: Final = {"holds": False, "found": "it was not played to its end; see build/kernel/out/output"}
    return [found.get(name, {"scene": name, **nothing}) for name in chosen]


def table(found: list[dict[str, Any]]) -> str:
    """A line for each scene, and what it found below."""
    lines = []
    for row in found:
        lines += [f"{'✓' if row['holds'] else '✗'} {SCENES[row['scene']].shows}", f"    {row['found']}"]
    return "\n".join([*lines, f"{sum(row['holds'] for row in found)} of {len(found)} scenes hold"])


def _report(parts: Parts, found: list[dict[str, Any]]) -> dict[str, Any]:
    """When, with what, and each scene."""
    commit = subprocess.run(["git", "rev-parse", "HEAD"], cwd=ROOT, capture_output=True, text=True, check=False)
    return {
        "date": datetime.now(UTC).date().isoformat(),
        "kernel": parts.release,
        "commit": commit.stdout.strip(),
        "scenes": [{name: row[name] for name in ("scene", "holds", "found")} for row in found],
    }


class Progress:
    """One line on a terminal that is written anew; elsewhere a line for each change."""

    def __init__(self) -> None:
        self._begun_s = time.monotonic()
        self._last = ""

    def say(self, text: str) -> None:
        """What is being done."""
        if sys.stdout.isatty():
            print(f"\r\x1b[K{time.monotonic() - self._begun_s:4.0f} s  {text}", end="", flush=True)
        elif text != self._last:
            print(text, flush=True)
        self._last = text

    def end(self) -> None:
        """The table follows."""
        if sys.stdout.isatty():
            print("\r\x1b[K", end="")


if __name__ == "__main__":
    sys.exit(main())
