"""All subjects, in the order of the way of a command."""

from tests.mutants.exposure import EXPOSURE
from tests.mutants.intake import INTAKE
from tests.mutants.legs import LEGS
from tests.mutants.mutant import Subject
from tests.mutants.pacing import PACING
from tests.mutants.supervisor import SUPERVISOR

SUBJECTS: tuple[Subject, ...] = (EXPOSURE, INTAKE, SUPERVISOR, LEGS, PACING)
