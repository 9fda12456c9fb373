"""The process in which libFuzzer runs, and which it ends; `tests.fuzz.run` starts it."""

import json
import os
import sys
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import atheris

from tests.fuzz.mutate import mutate_json

with atheris.instrument_imports(include=["gateway", "schemas"]):
    from tests.fuzz.targets import TARGETS


def rss_mb() -> float:
    """What this process holds of the machine's memory now."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def main(target: str, runs: int, notes: Path, libfuzzer: list[str]) -> None:
    """Fuzz `target`; note after each tenth of the runs, in a line of JSON, the memory held and what came of inputs."""
    check = TARGETS[target]
    tenth = max(1, runs // 10)
    came_of: Counter[str] = Counter()
    with notes.open("w") as file:

        def counted(data: bytes) -> None:
            came_of[check(data)] += 1
            if came_of.total() % tenth == 0:
                file.write(json.dumps({"rss_mb": rss_mb(), "came_of": came_of}) + "\n")
                file.flush()

        extra: dict[str, Callable[..., bytes]] = {}
        if target == "intake":
            extra = {"custom_mutator": mutate_command}
        atheris.Setup(["tests.fuzz", *libfuzzer, f"-runs={runs}"], counted, **extra)
        atheris.Fuzz()


def mutate_command(data: bytes, max_size: int, seed: int) -> bytes:
    """Every other time a change that knows JSON; else, and where there is none, one of libFuzzer's."""
    if seed % 2 and len(data) > 2:
        payload = mutate_json(data[2:], seed)
        if payload is not None:
            return (data[:2] + payload)[:max_size]
    return bytes(atheris.Mutate(data, max_size))


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), Path(sys.argv[3]), sys.argv[4:])
