"""The calibration guide of one page: takes its requests, asks the gateway, and answers with the guide's state.

Nothing here moves a servo. The page itself commands the servo under test, with its lease, and stops doing so when
nobody looks. So the guide's idea of where the servo stands may be old without any harm.
"""

import asyncio
from collections.abc import Callable
from typing import Any, Final

from gateway.errors import GatewayError
from gateway.model.calibration import CalibrationError, calibration_of
from gateway.model.framing import avoided_by
from gateway.people.client.payloads import calibration_payload
from gateway.people.commands.calibration import change_of, standing
from gateway.people.console.link import GatewayLink
from gateway.people.console.pages.guide import Guide
from gateway.people.console.pages.page_messages import CalibrateRequest, CalibrationMessage, Draft
from gateway.people.console.pages.page_tasks import PageTasks
from schemas import keys
from schemas.telemetry import GatewayState

MAX_STEPS: Final = 32
"""Most steps of one page that wait: a held key jogs ten times a second."""


class PageCalibration:
    """The guide of one page, on the event loop. Its steps are taken one after the other."""

    def __init__(
        self,
        link: GatewayLink,
        signed: Callable[[dict[str, Any]], dict[str, Any]],
        send: Callable[[CalibrationMessage], None],
    ) -> None:
        """`signed` adds the page's name and lease to a payload."""
        self._link = link
        self._signed = signed
        self._send = send
        self._guide: Guide | None = None
        self._tasks = PageTasks(MAX_STEPS, "calibration steps", in_turn=True)

    def ask(self, step: CalibrateRequest, *, mine: bool) -> None:
        """Take a step, and send the page the guide's state. `mine`: the page has the lease. Raises EndError."""
        self._tasks.check()
        self._tasks.start(self._run(step, mine=mine))

    async def _run(self, step: CalibrateRequest, *, mine: bool) -> None:
        said = error = None
        try:
            said = await self._take(step, mine=mine)
        except (GatewayError, CalibrationError) as fault:
            error = str(fault)
        self._send(self._view(step.id, said, error))

    async def _take(self, step: CalibrateRequest, *, mine: bool) -> str | None:
        if step.do == "open" or self._guide is None:
            await self._refresh()
        guide = self._guide
        if guide is None:
            raise CalibrationError("no calibration has been read yet")
        if step.do in ("write", "landing", "accept_default"):
            if not mine:
                raise CalibrationError("this page does not have the lease; press Drive first")
            if guide.servo_id is not None and step.do != "landing":
                raise CalibrationError(f"servo {guide.servo_id} is under test; stop it first")
            return await self._write(step, guide)
        return _on_paper(step, guide)

    async def _refresh(self) -> list[int]:
        """Read the calibration in force into the guide. Returns the servos that both this draft and others changed."""
        calibration = calibration_of(await asyncio.to_thread(self._link.client().calibration))
        if self._guide is None:
            self._guide = Guide(calibration, avoided_by((await self._state()).spi.framing))
            return []
        return self._guide.now_in_force(calibration)

    async def _state(self) -> GatewayState:
        return await asyncio.to_thread(self._link.client().state)

    async def _write(self, step: CalibrateRequest, guide: Guide) -> str:
        revision = guide.in_force.revision
        if step.do == "accept_default":
            payload, done = calibration_payload(accept_default=True), "the default calibration is in force"
        elif step.do == "landing":
            stand = standing(await self._state())
            if not stand:
                raise CalibrationError("no servo runs, so the robot's pose is not known: make it stand first")
            payload = calibration_payload(landing=stand, revision=revision)
            done = f"the landing pose of {len(stand)} servos is written"
        elif guide.changed:
            changes = {name: change_of(guide.draft[name]) for name in guide.changed}
            payload = calibration_payload(changes, dict.fromkeys(guide.landing_left_out), revision=revision)
            done = "written"
        else:
            raise CalibrationError("nothing has changed, so there is nothing to write")
        ack = await self._link.ask(keys.CALIBRATION_CMD, self._signed(payload), again=False)
        both = await self._refresh()
        if ack.accepted:
            return f"{done}: revision {guide.in_force.revision}"
        if guide.in_force.revision != revision and step.do != "accept_default":
            also = f" (servo {', '.join(map(str, both))} by both of you)" if both else ""
            raise CalibrationError(
                f"another person changed the calibration meanwhile{also}; check it, then write your changes again"
            )
        raise CalibrationError(f"rejected: {ack.reason}: {ack.detail}")

    def _view(self, number: int, said: str | None, error: str | None) -> CalibrationMessage:
        guide = self._guide
        if guide is None:
            return CalibrationMessage(id=number, error=error)
        changed, tested = guide.changed, guide.servo_id is not None
        return CalibrationMessage(
            id=number,
            revision=guide.in_force.revision,
            servos={
                servo_id: Draft(**servo.report.model_dump(), changed=servo_id in changed)
                for servo_id, servo in guide.draft.items()
            },
            landing={servo_id: angle / 100 for servo_id, angle in guide.in_force.landing_cdeg.items()},
            servo=guide.servo_id,
            shown_deg=guide.shown_deg if tested else None,
            command_deg=guide.command_deg if tested else None,
            said=said,
            error=error,
        )


def _on_paper(step: CalibrateRequest, guide: Guide) -> str | None:
    """Change the draft or the wanted angle, and nothing else. Returns what to show. Raises CalibrationError."""
    deg = 0.0 if step.deg is None else step.deg
    match step.do:
        case "test" if step.servo is not None:
            guide.choose(step.servo, deg)
        case "leave":
            guide.leave()
        case "jog":
            guide.jog(round(deg * 100))
        case "stands_at":
            guide.stands_at(deg)
        case "wrong_way":
            guide.wrong_way()
            return "turned round: + now has to be the way in which its angle grows"
        case "lowest_here":
            guide.lowest_here()
        case "highest_here":
            guide.highest_here()
        case "full_range":
            guide.full_range()
        case "as_drawn":
            guide.as_drawn()
        case "undo":
            servo_id = guide.undo()
            return "there is nothing to take back" if servo_id is None else f"taken back: servo {servo_id}"
    return None
