"""All subjects, in the order of the way of a command."""

from tests.mutants.exposure import EXPOSURE
from tests.mutants.intake import INTAKE
from tests.mutants.mutant import Subject
from tests.mutants.pacing import PACING

SUBJECTS: tuple[Subject, ...] = (EXPOSURE, INTAKE, PACING)
