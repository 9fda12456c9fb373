"""Changed inputs for each reader of foreign bytes, and what came of them (`FUZZ_TIMES=100`: as many times as many)."""

import os
import random
from collections import Counter

import pytest

from tests.fuzz.mutate import mutate, mutate_json
from tests.fuzz.seeds import seeds
from tests.fuzz.targets import TARGETS

TIMES = int(os.environ.get("FUZZ_TIMES", "1"))
RUNS = {"intake": TIMES * 40_000, "decode": TIMES * 30_000, "simulator": TIMES * 8_000}
"""Some seconds each."""
KEPT = 1000
"""Changed inputs that are changed further."""
WANTED = {
    "intake": {"intent", "invalid", "malformed", "too_large", "bad_encoding"},
    "decode": {"bytes: frame", "bytes: no frame", "typed: exit code 0", "typed: exit code 1"},
    "simulator": {"plain: some frames executed", "length-prefixed: some frames executed"},
}
"""What has to come of some: an input gets past the first check."""


@pytest.mark.parametrize("target", TARGETS)
def test_a_short_run_finds_nothing(target: str) -> None:
    seed = random.SystemRandom().randrange(2**31)
    chance = random.Random(seed)  # noqa: S311  a fuzzer wants to be repeatable
    begun = seeds(target)
    inputs = [*begun]
    came_of: Counter[str] = Counter()
    for number in range(RUNS[target]):
        data = mutate(chance.choice(inputs), chance)
        if target == "intake" and number % 2:
            before = chance.choice(inputs)
            data = before[:2] + (mutate_json(before[2:], chance) or data)
        try:
            came_of[TARGETS[target](data)] += 1
        except Exception as error:
            raise AssertionError(f"seed {seed}: {data!r}") from error
        if len(inputs) < KEPT:
            inputs.append(data)
        else:
            inputs[chance.randrange(len(begun), KEPT)] = data
    assert WANTED[target] <= came_of.keys(), came_of
