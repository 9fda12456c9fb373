"""What comes in on the calibration's key: read on the thread that hears it, before anybody owns the robot's state."""

from functools import partial
from typing import Final, Protocol

import zenoh

from gateway.robot.core.calibration_intake import CalibrationIntent, read
from gateway.robot.core.intake import Rejection
from gateway.robot.core.message import Reply
from gateway.robot.edge.receiver import Deal
from gateway.robot.edge.request_reader import payload_of

PAUSE_S: Final = 0.05
"""Between two changes: twenty a second, of which each may take a millisecond and a file. A person writes one."""


class Calibrations(Protocol):
    """Who decides; to be called by an owner of the state."""

    def change(self, intent: CalibrationIntent, source: str | None, reply: Reply) -> None:
        """Decide, and answer once that is kept."""

    def reject(self, source: str | None, rejection: Rejection, reply: Reply) -> None:
        """Answer what is rejected already, and tell of it."""


class CalibrationRequestReader:
    """Reads commands one by one, on one thread."""

    def __init__(self, calibrations: Calibrations) -> None:
        self._calibrations = calibrations

    def note(self, query: zenoh.Query, _now_ns: int, reply: Reply) -> Deal:
        """Read one query; what is then to be done with it, with a pause after it."""
        deal = self._note(query, reply)

        def paced() -> float:
            deal()
            return PAUSE_S

        return paced

    def _note(self, query: zenoh.Query, reply: Reply) -> Deal:
        source = str(query.source_info.source_id.zid) if query.source_info is not None else None
        payload = payload_of(query)
        if isinstance(payload, Rejection):
            return partial(self._calibrations.reject, source, payload, reply)
        return self.read(payload, reply, source)

    def read(self, payload: bytes, reply: Reply, source: str | None = None) -> Deal:
        """Read one payload; what is then to be done with it."""
        intent = read(payload)
        if isinstance(intent, Rejection):
            return partial(self._calibrations.reject, source, intent, reply)
        return partial(self._calibrations.change, intent, intent.source or source, reply)
