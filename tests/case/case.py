"""safety/case.toml as values; a fault in it is a sentence that names the claim."""

import tomllib
from pathlib import Path
from typing import Annotated, Final

from pydantic import BaseModel, ConfigDict, Field, model_validator

ROOT: Final = Path(__file__).parents[2]
CASE: Final = ROOT / "safety" / "case.toml"

SEARCH: Final = "tests/fuzz/test_model_check.py::test_every_reachable_state_keeps_every_promise"
"""It judges each step of each search by the promises of the model check."""

Text = Annotated[str, Field(min_length=1)]


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Hazard(_Part):
    """What may harm somebody."""

    text: Text


class Model(_Part):
    """A promise that the model check holds in every reachable state: words of a `demand` in tests/support."""

    promise: Text


class Mutants(_Part):
    """Of the faults that `make mutants` makes in a module, the share (%) that some test notices."""

    module: Text
    at_least: Annotated[float, Field(ge=0, le=100)]


class Figure(_Part):
    """A number that a test leaves in its JUnit record (`record_property`)."""

    test: Text
    name: Text
    at_least: float


class Bench(_Part):
    """A row of the benchmark, whose aim is its bound (tests/benchmarks): its name begins so."""

    row: Text


class Kernel(_Part):
    """A scene of `make kernel` (tests/kernel), on a real kernel's spidev."""

    scene: Text


class Person(_Part):
    """What nobody but a person can show, on the robot or beside it."""

    check: Text
    how: Text


class Defeater(_Part):
    """What would make the claim false and has not been excluded."""

    text: Text
    settled_by: Text


class Claim(_Part):
    """Something that holds, for the sake of hazards, and what shows it."""

    hazards: Annotated[list[str], Field(min_length=1)]
    text: Text
    section: Text
    """Where a document says it: `docs/design.md#seven-invariants`."""
    tests: list[Text] = []
    """`tests/unit/robot/test_guard.py::test_one_transfer`: of all its parameters, at least one, and each passes."""
    model: list[Model] = []
    mutants: list[Mutants] = []
    figures: list[Figure] = []
    drill: list[Text] = []
    """Steps of the drill, which a person runs on the robot."""
    bench: list[Bench] = []
    kernel: list[Kernel] = []
    person: list[Person] = []
    defeaters: list[Defeater] = []

    @model_validator(mode="after")
    def _has_evidence(self) -> "Claim":
        shown = self.tests or self.model or self.mutants or self.figures or self.bench or self.kernel
        if not (shown or self.person):
            raise ValueError("a claim without evidence")
        return self


class Case(_Part):
    """The whole tree."""

    hazards: dict[str, Hazard]
    claims: dict[str, Claim]
    judges: dict[str, list[Text]] = {}
    """Files and folders that a test judges which only `make test-all` runs."""

    @model_validator(mode="after")
    def _is_connected(self) -> "Case":
        unknown = {hazard for claim in self.claims.values() for hazard in claim.hazards} - self.hazards.keys()
        if unknown:
            raise ValueError(f"claims name hazards that do not exist: {', '.join(sorted(unknown))}")
        open_ones = self.hazards.keys() - {hazard for claim in self.claims.values() for hazard in claim.hazards}
        if open_ones:
            raise ValueError(f"hazards without a claim: {', '.join(sorted(open_ones))}")
        return self

    def tests(self) -> set[str]:
        """All tests that some claim leans on."""
        found = {test for claim in self.claims.values() for test in claim.tests}
        found |= {figure.test for claim in self.claims.values() for figure in claim.figures}
        return found | ({SEARCH} if any(claim.model for claim in self.claims.values()) else set())

    def about(self, hazard: str) -> dict[str, Claim]:
        """The claims that meet this hazard."""
        return {name: claim for name, claim in self.claims.items() if hazard in claim.hazards}


def load(path: Path = CASE) -> Case:
    """Raises pydantic.ValidationError, whose words name the claim."""
    return Case.model_validate(tomllib.loads(path.read_text(encoding="utf-8")))
