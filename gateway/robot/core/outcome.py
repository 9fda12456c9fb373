"""What became of the requests of one step: one pass, which the black box, the answers and the metrics read. Pure."""

from collections.abc import Sequence
from typing import Literal

from gateway.model.black_box.format import ACCEPTED, COALESCED
from gateway.robot.core.events import Command, Completed, Effect, Rejected, Request, Transmit
from schemas.telemetry import Reason

Verdict = Reason | Literal["accepted", "coalesced"]
Result = tuple[Request, Verdict, str]
"""A request, its verdict, and why it was rejected (one sentence)."""


def results(effects: Sequence[Effect], failed: Sequence[Transmit] = (), why: str = "") -> list[Result]:
    """Return the requests that these effects end, in their order, each with its verdict.

    `failed` are the frames that were not written, and `why` is the fault. It rejects the commands that these frames
    carry out, and no others: a request without a frame, such as a reset, has taken effect.
    """
    lost: list[Command] = []
    for transmit in failed:
        lost += transmit.commands
    found: list[Result] = []
    for effect in effects:
        match effect:
            case Transmit() | Completed():
                for request in effect.done:
                    if lost and request in lost:
                        found += [(request, Reason.BUS_FAULT, why)]
                    else:
                        coalesced = type(request) is Command and request.coalesced
                        found += [(request, COALESCED if coalesced else ACCEPTED, "")]
            case Rejected():
                found += [(effect.request, effect.reason, effect.detail)]
    return found
