"""The process that simulates the body: in real time, and at low priority. It reads its inputs without waiting.

The gateway's process starts it, and passes two pages of memory: this one reads the servos' targets in the first, and
writes what the body's sensors feel into the second. The end of its standard input is the end of the gateway. What it
has to report to people goes to stderr.
"""

import datetime as dt
import json
import os
import shutil
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any, Final

import zenoh

from gateway.errors import GatewayError
from gateway.geometry import Geometry, load
from gateway.host.shared_page import SensedPage, ServoPage
from gateway.model.calibration import RobotCalibration, calibration_of
from gateway.people.physics.assumed import Assumed, assumed
from gateway.people.physics.world import TIMESTEP_S, Sensors, World
from schemas import calibration as wire
from schemas.ack import Ack
from schemas.keys import CALIBRATION, SIM_BODY, SIM_UPRIGHT
from schemas.robot import SERVO_IDS
from schemas.simulation import BodyReport, SimulatedServo

TURN_S: Final = 0.01
"""The period in which the servos' targets are read."""
PUBLISH_S: Final = 1 / 30
SAME_S: Final = 5.0
"""The shortest time between two reports of a diverged simulation."""
NICE: Final = 10
"""All other processes, above all the gateway, have priority."""
MOST_BEHIND_S: Final = 0.1
"""Time behind real time beyond this is skipped: the body slows down and does not jump afterwards."""
WINDOW_S: Final = 2.0
"""The real-time factor is measured over this time."""
SLOW: Final = 0.95
"""Below this factor the machine is reported as slow; from `KEEPS_UP` on, as fast enough again."""
KEEPS_UP: Final = 0.99


class Pace:
    """Count the steps that are due, and measure how far a slow machine falls behind. Pure.

    Times are seconds of one monotonic clock.
    """

    def __init__(self, timestep_s: float, now_s: float) -> None:
        self._timestep_s = timestep_s
        self._next_s = now_s
        self._begun_s = now_s
        self._steps = 0
        self._is_slow = False
        self.factor = 1.0
        """Simulated seconds in a second of the latest window."""

    def due(self, now_s: float) -> int:
        """Return the number of steps to simulate now."""
        self._next_s = max(self._next_s, now_s - MOST_BEHIND_S)
        steps = max(0, int((now_s - self._next_s) / self._timestep_s))
        self._next_s += steps * self._timestep_s
        self._steps += steps
        return steps

    def report(self, now_s: float) -> str | None:
        """Return a sentence if, over the last window, the machine became too slow or fast enough again."""
        length_s = now_s - self._begun_s
        if length_s < WINDOW_S:
            return None
        self.factor = min(1.0, self._steps * self._timestep_s / length_s)
        self._begun_s, self._steps = now_s, 0
        if not self._is_slow and self.factor < SLOW:
            self._is_slow = True
            return (
                f"this machine simulates {self.factor:.2f} s of each second: the body moves more slowly than it would; "
                "the gateway is not delayed"
            )
        if self._is_slow and self.factor >= KEEPS_UP:
            self._is_slow = False
            return "this machine simulates the body in real time again"
        return None


class Simulated:
    """The world: driven by wire angles, reported in users' angles."""

    def __init__(self, geometry: Geometry, assumed: Assumed) -> None:
        """Raises ConfigError if MuJoCo cannot simulate this geometry."""
        self.world = World(geometry, assumed)
        self._geometry = geometry
        self._terrain = str(assumed.terrain)
        self._calibration = RobotCalibration()
        self._driven: dict[int, float | None] = dict.fromkeys(SERVO_IDS)

    def calibrate(self, calibration: RobotCalibration) -> None:
        """Convert wire angles to users' angles by this calibration from now on."""
        self._calibration = calibration
        driven, self._driven = self._driven, dict.fromkeys(SERVO_IDS)
        self.drive(driven)

    def drive(self, wire_deg: Mapping[int, float | None]) -> None:
        """Set each servo's target in wire degrees; None: off."""
        for servo_id, angle_deg in wire_deg.items():
            if angle_deg is None and self._driven[servo_id] is not None:
                self.world.drive(servo_id, None)
            elif angle_deg is not None and angle_deg != self._driven[servo_id]:
                user_deg = self._calibration.of(servo_id).user_cdeg(round(100 * angle_deg)) / 100
                self.world.drive(servo_id, self._geometry.joint_rad(servo_id, user_deg))
        self._driven = dict(wire_deg)

    def report(self, real_time_factor: float) -> BodyReport:
        """Return the body's pose, feet and servos for publication."""
        body = self.world.body()
        servos = {
            str(servo_id): SimulatedServo(
                angle_deg=round(self._geometry.servos[servo_id].servo_deg(joint_rad), 2),
                torque_nm=round(body.torques_nm[servo_id], 3),
            )
            for servo_id, joint_rad in body.joints_rad.items()
        }
        return BodyReport(
            time=dt.datetime.now(dt.UTC),
            position_m=_rounded(body.position_m),
            orientation_xyzw=_rounded(body.rotation),
            velocity_m_s=_rounded(body.velocity_m_s),
            upright=body.upright,
            feet=body.feet,
            servos=servos,
            terrain=self._terrain,
            real_time_factor=round(real_time_factor, 3),
        )


class Link:
    """The session with the gateway: Zenoh's threads fill queues, and the simulation polls them."""

    def __init__(self) -> None:
        self.ended = threading.Event()
        """Set when the gateway has ended."""
        self.calibrations: SimpleQueue[RobotCalibration] = SimpleQueue()
        self.upright: SimpleQueue[zenoh.Query] = SimpleQueue()
        self._declared: list[Any] = []
        self._publisher: Any = None
        self._number = 0
        threading.Thread(target=self._run, name="lifeline", daemon=True).start()

    def publish(self, report: Callable[[], BodyReport]) -> None:
        """Publish a report if the gateway is there and anybody subscribes. Zenoh drops it if a link is congested."""
        if self._publisher is None or not self._publisher.matching_status.matching:
            return
        self._number += 1
        info = zenoh.SourceInfo(self._publisher.id, self._number)
        with suppress(zenoh.ZError):
            self._publisher.put(report().model_dump_json(), source_info=info)

    def _run(self) -> None:
        line = sys.stdin.readline()
        if line:
            config = zenoh.Config.from_json5(line)
            threading.Thread(target=self._connect, args=(config,), name="connect", daemon=True).start()
            while sys.stdin.readline():
                pass
        self.ended.set()

    def _connect(self, config: zenoh.Config) -> None:
        try:
            session = zenoh.open(config)
        except zenoh.ZError as error:
            _say(f"it cannot publish the body: {' '.join(str(error).split())}")
            return
        self._declared = [
            session,
            session.declare_subscriber(CALIBRATION, self._take_calibration),
            session.declare_queryable(  # a listing of all keys sets nobody upright
                SIM_UPRIGHT, lambda query: self.upright.put(query) if str(query.key_expr) == SIM_UPRIGHT else None
            ),
        ]
        for reply in session.get(CALIBRATION):
            if reply.ok is not None:
                self._take_calibration(reply.ok)
        self._publisher = session.declare_publisher(
            SIM_BODY,
            encoding=zenoh.Encoding.APPLICATION_JSON,
            congestion_control=zenoh.CongestionControl.DROP,
            priority=zenoh.Priority.DATA_LOW,
        )

    def _take_calibration(self, sample: zenoh.Sample) -> None:
        with suppress(ValueError):  # none that a gateway publishes
            report = wire.Calibration.model_validate_json(sample.payload.to_bytes())
            self.calibrations.put(calibration_of(report))


def simulate(simulated: Simulated, page: ServoPage, sensed: SensedPage, link: Link) -> None:
    """Step the world in real time until the gateway ends."""
    pace, sensors = Pace(TIMESTEP_S, time.monotonic()), Sensors(simulated.world)
    publish_s = said_s = 0.0
    while not link.ended.wait(TURN_S):
        simulated.drive(page.read())
        with suppress(Empty):
            simulated.calibrate(link.calibrations.get_nowait())
        for _ in range(pace.due(time.monotonic())):
            simulated.world.step()
        now_s = time.monotonic()
        fault = simulated.world.fault()
        if fault is not None and now_s - said_s > SAME_S:
            said_s = now_s
            _say(fault)
        sensed.write(sensors.read())
        if (slow := pace.report(now_s)) is not None:
            _say(slow)
        with suppress(Empty):
            query = link.upright.get_nowait()
            simulated.world.set_upright()
            with suppress(zenoh.ZError), query:
                query.reply(SIM_UPRIGHT, Ack(accepted=True).model_dump_json(), encoding=zenoh.Encoding.APPLICATION_JSON)
        if now_s >= publish_s:
            publish_s = max(publish_s + PUBLISH_S, now_s)
            link.publish(partial(simulated.report, pace.factor))


def _rounded(values: Iterable[float]) -> Any:
    return tuple(round(value, 5) for value in values)


def _say(sentence: str) -> None:
    sys.stderr.write(f"physics: {sentence}\n")
    sys.stderr.flush()


def main(arguments: Sequence[str]) -> int:
    """Run until the gateway ends. Ctrl-C, Ctrl-\\ and the end of the terminal go to the gateway."""
    for number in (signal.SIGINT, signal.SIGQUIT, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    os.setpriority(os.PRIO_PROCESS, 0, NICE)
    options: dict[str, Any] = json.loads(arguments[0])
    try:
        what = assumed(options["mass_kg"], options["torque_nm"], options["friction"], options["terrain"])
        simulated = Simulated(load(options["geometry"] and Path(options["geometry"])), what)
        sys.stdout.write("ready\n")
        sys.stdout.flush()
        if (overlap := simulated.world.overlap()) is not None:
            _say(overlap)
        simulate(simulated, ServoPage(options["page"]), SensedPage(options["sensed"]), Link())
    except GatewayError as error:
        sys.stdout.write(f"{error}\n")
        sys.stdout.flush()
        return error.exit_code
    finally:
        shutil.rmtree(options["folder"], ignore_errors=True)
    return 0


if __name__ == "__main__":
    os._exit(main(sys.argv[1:]))  # not by the interpreter's own end, which aborts while a thread is inside Zenoh
