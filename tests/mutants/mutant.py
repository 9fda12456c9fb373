"""What a mutant is: one small fault, made by hand in one place, and the tests that ought to notice it."""

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, slots=True)
class Mutant:
    """`old`, which stands exactly once in its file, becomes `new`; `why` says what somebody would suffer from that."""

    old: str
    new: str
    why: str
    equivalent: str = ""
    """Why no test can tell it from the original; empty where one can."""


@dataclass(frozen=True, slots=True)
class Subject:
    """A file, the tests that belong to it (those that find most come first), and its mutants."""

    file: str
    tests: tuple[str, ...]
    mutants: tuple[Mutant, ...]


def mutated(text: str, mutant: Mutant) -> str:
    """The file's text with the fault in it. Raises ValueError where the text has changed since the mutant was made."""
    found = text.count(mutant.old)
    if found != 1:
        raise ValueError(f"stands {found} times in it, and must once: {mutant.old!r}")
    if mutant.old == mutant.new:
        raise ValueError(f"changes nothing: {mutant.old!r}")
    return text.replace(mutant.old, mutant.new)


def check(subject: Subject, root: Path) -> None:
    """Every mutant fits the file as it is. Raises ValueError with all that do not."""
    text = (root / subject.file).read_text(encoding="utf-8")
    faults = []
    for mutant in subject.mutants:
        try:
            compile(mutated(text, mutant), subject.file, "exec")
        except (ValueError, SyntaxError) as error:
            faults.append(f"{subject.file}: {error}")
    if faults:
        raise ValueError("\n".join(faults))
