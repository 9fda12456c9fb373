"""What happens, told to everybody who wants to know: the log, whoever listens on Zenoh, and the black box."""

import logging
from typing import Final

from gateway.robot.blackbox.recorder import Recorder, Written
from gateway.robot.core.message import Outbox
from gateway.robot.runtime.report import WARNINGS, wall_clock
from schemas import keys, telemetry
from schemas.telemetry import Kind, Reason

logger: Final = logging.getLogger(__name__)


class Teller:
    """Events and frames go out through here."""

    def __init__(self, outbox: Outbox, recorder: Recorder) -> None:
        self._outbox = outbox
        self._recorder = recorder

    def event(
        self,
        kind: Kind,
        detail: str,
        source: str | None = None,
        key: str | None = None,
        reason: Reason | None = None,
        left_out: int = 0,
        legs: tuple[int, ...] = (),
    ) -> None:
        """Tell an event; `legs`, ascending, are those that it is about."""
        incident = self._recorder.event(kind, source, key, reason, detail, left_out, legs)
        level = logging.WARNING if kind in WARNINGS else logging.INFO
        extra = {
            "kind": kind, "source": source, "key": key, "reason": reason, "left_out": left_out or None,
            "legs": list(legs) or None, "incident": incident,
        }  # fmt: skip
        logger.log(level, detail, extra=extra)
        event = telemetry.Event(
            time=wall_clock(), kind=kind, source=source, key=key, reason=reason, detail=detail, left_out=left_out,
            legs=legs, incident=incident,
        )  # fmt: skip
        self._outbox.publish(keys.EVENT, event)

    def frames(self, written: list[Written]) -> None:
        """Publish the frames of a step, after the last of them was written."""
        for frame in written:
            record = telemetry.FrameRecord(
                time=wall_clock(), monotonic_ns=frame.ns, bytes=frame.data.hex(), cause=frame.cause
            )
            self._outbox.publish(keys.FRAME, record)
