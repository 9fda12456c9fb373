"""All subjects, in the order of the way of a command."""

from tests.mutants.access import ACCESS, ZENOH_FILES
from tests.mutants.bus import BUS, GUARD
from tests.mutants.calibration import CALIBRATING, CALIBRATION, REACH
from tests.mutants.calibration_request_reader import CALIBRATION_DESK, CALIBRATION_INTAKE, CALIBRATIONS, DESKS
from tests.mutants.conductor import ANSWERS, CONDUCTOR, LOSSES
from tests.mutants.exposure import EXPOSURE
from tests.mutants.inbox import INBOX, MESSAGE, RINGS
from tests.mutants.intake import INTAKE
from tests.mutants.lease import DESK, LEASE, NONCES, PROOF
from tests.mutants.leg import LEG
from tests.mutants.legs import LEGS
from tests.mutants.motion import LANDING, SPEED
from tests.mutants.mutant import Subject
from tests.mutants.ownership import OWNERSHIP, RECEIVER
from tests.mutants.pacing import PACING
from tests.mutants.staleness import STALENESS
from tests.mutants.supervisor import SUPERVISOR, TABLE

SUBJECTS: tuple[Subject, ...] = (
    EXPOSURE,
    ACCESS,
    ZENOH_FILES,
    INBOX,
    RECEIVER,
    OWNERSHIP,
    RINGS,
    MESSAGE,
    INTAKE,
    STALENESS,
    CONDUCTOR,
    ANSWERS,
    LOSSES,
    SUPERVISOR,
    TABLE,
    REACH,
    CALIBRATING,
    CALIBRATION,
    LEASE,
    NONCES,
    PROOF,
    DESK,
    DESKS,
    CALIBRATION_DESK,
    CALIBRATION_INTAKE,
    CALIBRATIONS,
    LEG,
    LEGS,
    PACING,
    SPEED,
    LANDING,
    BUS,
    GUARD,
)
