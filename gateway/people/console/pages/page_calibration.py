"""The calibration guide of one page: takes its requests, asks the gateway, and answers with the guide's state.

Nothing here moves a servo. The page itself commands the servo under test, with its lease, and stops doing so when
nobody looks. So the guide's idea of where the servo stands may be old without any harm.

The servo is always commanded by the calibration in force, since the gateway knows no other. What the person sees
concerns the servo itself, so it is kept as its angle on the wire; only the draft changes until it is written.
"""

import asyncio
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Final

from gateway.errors import GatewayError
from gateway.model.calibration import (
    AS_DRAWN,
    CalibrationError,
    RobotCalibration,
    ServoMapping,
    calibration_of,
    changed_servos,
)
from gateway.model.frames import MAX_ANGLE_CDEG, avoided_by, centidegrees
from gateway.people.client.payloads import calibration_payload
from gateway.people.commands.calibration import change_of, standing
from gateway.people.console.link import GatewayLink
from gateway.people.console.pages.page_messages import CalibrateRequest, Message
from gateway.people.console.pages.page_tasks import PageTasks
from schemas import keys
from schemas.gateway_state import GatewayState
from schemas.robot import SERVO_IDS


@dataclass
class Guide:
    """Angles are in degrees (`_deg`) or hundredths of a degree (`_cdeg`). Each change of the draft can be undone."""

    in_force: RobotCalibration
    avoid_cdeg: tuple[int, int] | None = None
    """Angles on the wire that the gateway never sends: from the first up to, not including, the second."""
    draft: dict[int, ServoMapping] = field(init=False)
    servo_id: int | None = None
    """The servo under test, or None."""
    wire_cdeg: int = 0
    """The commanded angle of the servo under test, on the wire."""
    _before: list[tuple[int, ServoMapping]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.draft = {servo_id: self.in_force.of(servo_id) for servo_id in SERVO_IDS}

    # ---- the servo under test

    def choose(self, servo_id: int, shown_deg: float) -> None:
        """Test this servo, from this angle by the draft.

        Raises CalibrationError for a servo that does not exist, or an angle that the calibration in force rejects.
        """
        if servo_id not in SERVO_IDS:
            raise CalibrationError(f"servo {servo_id} does not exist; an id is the leg and the joint, such as 32")
        self._move_to(servo_id, self.draft[servo_id].wire_cdeg(centidegrees(shown_deg)))

    def jog(self, by_cdeg: int) -> None:
        """Move by this angle by the draft, or past the angles that are never sent.

        Raises CalibrationError at the limits of the calibration in force.
        """
        servo_id, servo = self._under_test()
        wire_cdeg = self.wire_cdeg + (-by_cdeg if servo.inverted else by_cdeg)
        if self.avoid_cdeg is not None and self.avoid_cdeg[0] <= wire_cdeg < self.avoid_cdeg[1]:
            wire_cdeg = self.avoid_cdeg[0] - 1 if wire_cdeg < self.wire_cdeg else self.avoid_cdeg[1]
        if not 0 <= wire_cdeg <= MAX_ANGLE_CDEG:
            raise CalibrationError(f"servo {servo_id} cannot go further: its own angle would be {wire_cdeg / 100:g}")
        self._move_to(servo_id, wire_cdeg)

    @property
    def command_deg(self) -> float:
        """The angle to command, by the calibration in force."""
        servo_id, _ = self._under_test()
        return self.in_force.of(servo_id).user_cdeg(self.wire_cdeg) / 100

    @property
    def shown_deg(self) -> float:
        """The servo's angle by the draft."""
        _, servo = self._under_test()
        return servo.user_cdeg(self.wire_cdeg) / 100

    # ---- what the person sees

    def change(self, how: str, seen_deg: float = 0.0) -> None:
        """Change the draft of the servo under test. `how`: a case below. Raises CalibrationError if it cannot be so."""
        servo_id, servo = self._under_test()
        match how:
            case "stands_at":  # the trim, by its angle now as measured on the robot
                untrimmed_cdeg = servo._replace(trim_cdeg=0).wire_cdeg(centidegrees(seen_deg))
                wanted = servo._replace(trim_cdeg=self.wire_cdeg - untrimmed_cdeg)
            case "wrong_way":  # its middle and its two limits stay where they are on the robot
                low_cdeg, high_cdeg = MAX_ANGLE_CDEG - servo.max_cdeg, MAX_ANGLE_CDEG - servo.min_cdeg
                wanted = servo._replace(inverted=not servo.inverted, min_cdeg=low_cdeg, max_cdeg=high_cdeg)
            case "lowest_here":
                wanted = servo._replace(min_cdeg=servo.user_cdeg(self.wire_cdeg))
            case "highest_here":
                wanted = servo._replace(max_cdeg=servo.user_cdeg(self.wire_cdeg))
            case "full_range":
                wanted = servo._replace(min_cdeg=0, max_cdeg=MAX_ANGLE_CDEG)
            case _:  # as drawn
                wanted = AS_DRAWN
        RobotCalibration(servos={servo_id: wanted})  # raises CalibrationError
        if wanted != servo:
            self._before.append((servo_id, servo))
            self.draft[servo_id] = wanted

    def undo(self) -> int | None:
        """Undo the draft's latest change; returns its servo, None if there is none."""
        if not self._before:
            return None
        servo_id, servo = self._before.pop()
        self.draft[servo_id] = servo
        return servo_id

    # ---- to write

    @property
    def changed(self) -> list[int]:
        """The servos whose calibration the draft changes."""
        return changed_servos(self.in_force, RobotCalibration(servos=self.draft))

    def now_in_force(self, calibration: RobotCalibration) -> list[int]:
        """Another calibration is in force, by this draft or by another person's change.

        The draft keeps its changed servos, and takes all others from the new calibration. Returns the servos that both
        changed, and differently.
        """
        mine = self.changed
        theirs = changed_servos(self.in_force, calibration)
        self.in_force = calibration
        self.draft = {name: self.draft[name] if name in mine else calibration.of(name) for name in SERVO_IDS}
        return [servo_id for servo_id in self.changed if servo_id in theirs]

    # ---- inside

    def _under_test(self) -> tuple[int, ServoMapping]:
        if self.servo_id is None:
            raise CalibrationError("choose a servo first")
        return self.servo_id, self.draft[self.servo_id]

    def _move_to(self, servo_id: int, wire_cdeg: int) -> None:
        """Raises CalibrationError if the gateway would reject this angle by the calibration in force."""
        user_cdeg = self.in_force.of(servo_id).user_cdeg(wire_cdeg)
        if not 0 <= user_cdeg <= MAX_ANGLE_CDEG:
            raise CalibrationError(
                f"the calibration in force has no command for it ({user_cdeg / 100:g} degrees); write the draft first"
            )
        why_not = self.in_force.why_not(servo_id, user_cdeg)
        if why_not is not None:
            raise CalibrationError(why_not)
        self.servo_id, self.wire_cdeg = servo_id, wire_cdeg


MAX_STEPS: Final = 32
"""Most steps of one page that wait: a held key jogs ten times a second."""


class PageCalibration:
    """The guide of one page, on the event loop. Its steps are taken one after the other."""

    def __init__(
        self,
        link: GatewayLink,
        signed: Callable[[dict[str, Any]], dict[str, Any]],
        send: Callable[[Message], None],
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
        view: Message = {"type": "calibration", "id": step.id, "note": None, "error": None, "servos": {}}
        try:
            view["note"] = await self._take(step, mine=mine)
        except (GatewayError, CalibrationError) as fault:
            view["error"] = str(fault)
        if (guide := self._guide) is not None:
            changed = guide.changed
            view["servos"] = {
                servo_id: {**servo.report.model_dump(), "changed": servo_id in changed}
                for servo_id, servo in guide.draft.items()
            }
            view["landing"] = {servo_id: angle / 100 for servo_id, angle in guide.in_force.landing_cdeg.items()}
            view |= {"revision": guide.in_force.revision, "servo": guide.servo_id}
            if guide.servo_id is not None:
                view |= {"shown_deg": guide.shown_deg, "command_deg": guide.command_deg}
        self._send(view)

    async def _take(self, step: CalibrateRequest, *, mine: bool) -> str | None:
        if step.do == "open" or self._guide is None:
            await self._refresh()
        guide, deg = self._guide, step.deg or 0.0
        if guide is None:
            raise CalibrationError("no calibration has been read yet")
        match step.do:
            case "write" | "landing" | "accept_default":
                if not mine:
                    raise CalibrationError("this page does not have the lease")
                if guide.servo_id is not None and step.do != "landing":
                    raise CalibrationError(f"servo {guide.servo_id} is under test; stop it first")
                return await self._write(step, guide)
            case "test":
                guide.choose(step.servo or 0, deg)
            case "leave":
                guide.servo_id = None
            case "jog":
                guide.jog(round(deg * 100))
            case "undo":
                servo_id = guide.undo()
                return "there is nothing to take back" if servo_id is None else f"taken back: servo {servo_id}"
            case how if how != "open":
                guide.change(how, deg)
                return "turned round: + now has to be the way in which its angle grows" if how == "wrong_way" else None
        return None

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
            drafted, landing = RobotCalibration(servos=guide.draft), guide.in_force.landing_cdeg
            left_out = [name for name, angle_cdeg in sorted(landing.items()) if drafted.why_not(name, angle_cdeg)]
            payload = calibration_payload(changes, dict.fromkeys(left_out), revision=revision)
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
