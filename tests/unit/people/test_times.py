"""The times of the people's wing's rules, as documents and the gateway's own times want them.

The tests of each rule take its times by name. Who changes one here looks at what leans on it: the reasons stand beside
each in the code.
"""

from types import ModuleType

import pytest

from gateway.people.client import pace, patience, renewal
from gateway.people.walking import ride, words
from gateway.people.watching import confirmed_stop, silence

TIMES: dict[tuple[ModuleType, str], float] = {
    (confirmed_stop, "AGAIN_NS"): 100_000_000,
    (confirmed_stop, "REQUESTS_AT_ONCE"): 4,
    (confirmed_stop, "MAX_PRESSES"): 16,
    (pace, "LATE_PART"): 0.5,
    (pace, "RADIANS_S"): 1.0,
    (pace, "MOST_DEG"): 3.2,
    (pace, "SILENCE_S"): 0.5,
    (patience, "RESEND_S"): 0.05,
    (patience, "ATTEMPT_S"): 1.0,
    (patience, "OTHER_WAY_S"): 0.2,
    (renewal, "RENEWALS"): 3,
    (ride, "START_PAUSE_S"): 0.015,
    (silence, "CHECK_EVERY_S"): 0.1,
    (silence, "SILENT_MS"): 1000,
    (words, "NEWS_S"): 1.0,
}


@pytest.mark.parametrize(("module", "name"), TIMES, ids=lambda part: getattr(part, "__name__", part))
def test_each_time_is_as_decided(module: ModuleType, name: str) -> None:
    assert getattr(module, name) == TIMES[module, name]
