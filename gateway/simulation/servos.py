"""The 18 servos behind a simulated controller: driven or slack, fed or not, and as fast as their motors are."""

from dataclasses import dataclass

from gateway.host.shared_page import ServoPage
from gateway.model.power_board import NO_LOAD_DEG_S
from schemas.robot import SERVO_IDS


@dataclass(slots=True)
class ServoState:
    """One servo: PWM output on or off, where it is sent (None before the first), and where its horn is, 0° to 180°."""

    energised: bool = False
    target_deg: float | None = None
    angle_deg: float = 90.0  # before it is first energised, a horn stands wherever it was left
    pulse_us: int | None = None  # where its controller counts one
    fed: bool = True  # until a simulated power board says otherwise

    @property
    def driven(self) -> bool:
        """Whether it holds where it is sent: its output is on, and it has supply."""
        return self.energised and self.fed

    @property
    def moves(self) -> bool:
        """Whether it is on its way."""
        return self.driven and self.target_deg is not None and self.target_deg != self.angle_deg


class SimulatedServos(dict[int, ServoState]):
    """The 18 by id. Times are of one monotonic clock."""

    def __init__(self, now_ns: int, page: ServoPage | None) -> None:
        """All off. Into `page` goes where each is sent; it says which of them have supply."""
        super().__init__((servo_id, ServoState()) for servo_id in SERVO_IDS)
        self._page = page
        self._moved_ns = now_ns

    def send(self, servo_id: int, target_deg: float | None, *, start: bool) -> None:
        """Send it there, as far as its horn goes. One that is off stays off unless `start`."""
        servo = self[servo_id]
        servo.target_deg = None if target_deg is None else max(0.0, min(target_deg, 180.0))
        servo.energised = servo.energised or start
        self._show(servo_id, servo)

    def stop(self, servo_id: int) -> None:
        """Its output goes off, and its horn stays."""
        servo = self[servo_id]
        servo.energised = False
        self._show(servo_id, servo)

    def move(self, now_ns: int) -> None:
        """Where their horns are by now, without load."""
        reach_deg = NO_LOAD_DEG_S * (now_ns - self._moved_ns) / 1e9
        self._moved_ns = now_ns
        fed = self.keys() if self._page is None else self._page.fed
        for servo_id, servo in self.items():
            servo.fed = servo_id in fed
            if servo.driven and servo.target_deg is not None:
                way_deg = servo.target_deg - servo.angle_deg
                servo.angle_deg = (
                    servo.target_deg
                    if abs(way_deg) <= reach_deg
                    else servo.angle_deg + max(-reach_deg, min(way_deg, reach_deg))
                )

    def _show(self, servo_id: int, servo: ServoState) -> None:
        if self._page is not None:
            self._page.write(servo_id, servo.target_deg if servo.energised else None)
