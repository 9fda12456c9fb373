"""One fuzzing run in a process of its own, and what came of it."""

import json
import re
import resource
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from tests.fuzz.seeds import MAX_LEN, dictionary, seeds

MAX_GROWTH_MB = 8.0
"""Between a tenth of the runs and the end: ten million took less than 1 MB, most of it the fuzzer's own corpus."""
_DONE = re.compile(r"^#(?P<inputs>\d+)\s+DONE\s+cov: (?P<edges>\d+)", re.M)


@dataclass(frozen=True, slots=True)
class Report:
    """What a run came to. `finding` is what the fuzzer said where something was found, shortened, else empty."""

    inputs: int
    edges: int
    rss_mb: tuple[float, ...]
    came_of: Mapping[str, int]
    finding: str

    @property
    def growth_mb(self) -> float:
        """Memory at the end, less that after a tenth of the runs."""
        return self.rss_mb[-1] - self.rss_mb[0] if self.rss_mb else 0.0


def fuzz(target: str, runs: int, folder: Path, seed: int) -> Report:
    """Run `target` on `runs` inputs. `folder` takes the corpus, and what is found."""
    corpus = folder / f"corpus-{target}"
    corpus.mkdir(parents=True, exist_ok=True)
    for number, data in enumerate(seeds(target)):
        (corpus / f"seed-{number:03}").write_bytes(data)
    words = folder / "words.dict"
    words.write_text(dictionary())
    notes = folder / f"notes-{target}"
    options = (
        str(corpus),
        f"-dict={words}",
        f"-seed={seed}",
        f"-max_len={MAX_LEN[target]}",
        f"-artifact_prefix={folder / target}-",
        # libFuzzer looks at the peak, and a process begins with that of whoever has started it.
        f"-rss_limit_mb={512 + resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024}",
        "-timeout=5",  # seconds for one input, which takes microseconds
    )
    command = [sys.executable, "-m", "tests.fuzz.worker", target, str(runs), str(notes), *options]
    ran = subprocess.run(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace", check=False
    )
    done = _DONE.search(ran.stdout)
    numbers = {name: int(number) for name, number in done.groupdict().items()} if done else {}
    noted = [json.loads(line) for line in notes.read_text().splitlines()] if notes.exists() else []
    return Report(
        inputs=numbers.get("inputs", 0),
        edges=numbers.get("edges", 0),
        rss_mb=tuple(note["rss_mb"] for note in noted),
        came_of=noted[-1]["came_of"] if noted else {},
        finding="" if ran.returncode == 0 and done else _finding(ran.stdout),
    )


def _finding(said: str) -> str:
    """From the exception on, where there is one: an input may be longer than all that is kept."""
    return said[max(said.find("=== Uncaught Python exception"), 0) :][:2000] + " … " + said[-2000:]
