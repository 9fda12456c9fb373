"""Judges what a step's requests are answered, whichever of its frames fail."""

from collections.abc import Sequence

from gateway.robot.core.events import Effect, Transmit, results
from schemas.telemetry import Reason
from tests.support.history import demand


def judge_results(effects: Sequence[Effect]) -> None:
    """Judge the pass over a step's outcome: all frames are written, one fails, or all do. Raises Violation."""
    undisturbed = results(effects)
    if not undisturbed:
        return
    requests = [request for request, _, _ in undisturbed]
    demand(len({id(each) for each in requests}) == len(requests), "a request is answered once")
    frames = [effect for effect in effects if isinstance(effect, Transmit)]
    for failed in (frames, *([each] for each in frames)):
        carried = {id(command) for frame in failed for command in frame.commands}
        disturbed = results(effects, failed, "a test's fault")
        demand([each for each, _, _ in disturbed] == requests, "a fault changes verdicts, and no order")
        for (request, before, _), (_, verdict, why) in zip(undisturbed, disturbed, strict=True):
            fails = id(request) in carried and not isinstance(before, Reason)
            expected = Reason.BUS_FAULT if fails else before
            demand(verdict == expected, f"of failed frames: {expected} and not {verdict} for request {request.number}")
            demand(bool(why) == isinstance(verdict, Reason), "a rejection has its sentence, and nothing else has one")
