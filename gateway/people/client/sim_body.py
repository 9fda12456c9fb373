"""A simulated body: only the process that the state names reports it; and somebody may set it upright."""

from typing import TYPE_CHECKING, Final

import zenoh

from gateway.errors import UnansweredError
from schemas.keys import SIM_UPRIGHT
from schemas.telemetry import Ack

if TYPE_CHECKING:
    from gateway.people.client.blocking import Client

ANSWER_S: Final = 2.0


def is_of_physics(sample: zenoh.Sample, physics: str | None) -> bool:
    """Whether the process with this Zenoh id has published it. Without access control, anybody may publish there."""
    source = sample.source_info
    return physics is not None and source is not None and str(source.source_id.zid) == physics


def set_upright(client: "Client") -> Ack:
    """Put a robot that is simulated with physics on its feet, as somebody would. Raises UnansweredError."""
    for reply in client.session.get(SIM_UPRIGHT, timeout=ANSWER_S):
        if reply.ok is not None:
            return Ack.model_validate_json(reply.ok.payload.to_bytes())
    raise UnansweredError("no simulated body answers: set upright is for `run --sim=physics`")
