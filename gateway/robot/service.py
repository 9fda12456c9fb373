"""Builds and connects the service's parts, and runs them from start to end."""

import asyncio
import logging
import mmap
import os
import selectors
import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from functools import partial
from math import ceil
from pathlib import Path
from typing import Any, Final

import zenoh

from gateway import __version__, certs
from gateway.errors import GatewayError
from gateway.host import descriptors, effective, logs, realtime
from gateway.host.directories import forgets, runtime_directory, state_directory
from gateway.host.settings_reader import ForStops
from gateway.host.worker import in_thread
from gateway.model.black_box import STOP_FACTS
from gateway.model.frames import centidegrees
from gateway.model.protocols import called
from gateway.rate_limit import NS_PER_MS, NS_PER_S
from gateway.robot import wires
from gateway.robot.blackbox.recorder import Recorder
from gateway.robot.core.backlog import START_WAIT_NS
from gateway.robot.core.message import Reply
from gateway.robot.core.rules import Rules
from gateway.robot.core.supervisor import Supervisor
from gateway.robot.host.disk import StateFolder, report_mistake
from gateway.robot.host.ownership import Ownership
from gateway.robot.host.systemd import SystemdNotifier
from gateway.robot.power.line import PowerLine
from gateway.robot.runtime.calibrations import Calibrations
from gateway.robot.runtime.conductor import Conductor
from gateway.robot.runtime.estop_keeper import READ_S, EstopKeeper, take_over
from gateway.robot.runtime.report import wall_clock
from gateway.robot.runtime.request_answers import ButtonAnswers, LeaseAnswers
from gateway.robot.runtime.revocations import Revocations, list_common_names, revocation_state
from gateway.robot.runtime.shutdown import SHUTDOWN_S, ServiceEnd, close_within, stop_the_robot
from gateway.robot.settings import Settings
from gateway.robot.spi.cyclic import run_cycles
from gateway.robot.spi.stop_all import take_note
from gateway.robot.wires import SimulatedParts
from gateway.robot.zenoh_io.connection_limiter import ConnectionLimiter
from gateway.robot.zenoh_io.inbox import Inbox
from gateway.robot.zenoh_io.outbox import ZenohOutbox
from gateway.robot.zenoh_io.receiver import OwnersTask
from gateway.robot.zenoh_io.rings import put_depth
from gateway.robot.zenoh_io.session import Upkeep, receive_each_session_alone, service_config
from gateway.robot.zenoh_io.unknown_keys import UnknownKeys
from schemas.config import CertificateReport
from schemas.keys import CALIBRATION, CONFIG, STATE, TELEMETRY

BEAT_S = 0.1
"""Period of a beat: measure the loop's lag, notify systemd, publish state and telemetry. It suits people who watch a
page. A systemd watchdog may need a shorter period."""
REST_BEAT_S: Final = 0.3
"""The same while nothing runs and nobody listens: more than half of a beat's time is the wake of an idle processor."""

SERVOS_FILE: Final = "servos"
_LINE: Final = "%020d %d\n"

logger = logging.getLogger(__name__)


class ServosFile:
    """A file that shows whether a servo runs, for an upgrade and `setup`, which have no certificate to ask over Zenoh.

    It has one line, `MONOTONIC_NS 0` or `MONOTONIC_NS 1`, written at each beat. It is memory-mapped, so a write
    needs no system call. A line older than a second means that the service hangs.
    """

    def __init__(self, folder: Path | None) -> None:
        """`folder` is the service's runtime directory. None: no file is written."""
        self._map: mmap.mmap | None = None
        if folder is None:
            return
        try:
            descriptor = os.open(folder / SERVOS_FILE, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)
            size = len(_LINE % (0, 0))
            with os.fdopen(descriptor, "r+b") as file:
                file.truncate(size)
                os.posix_fallocate(descriptor, 0, size)  # in a full folder, a later write would end in SIGBUS
                self._map = mmap.mmap(descriptor, 0)
        except OSError as error:
            logger.warning("an upgrade cannot see whether a servo runs: %s", error)

    def write(self, now_ns: int, *, any_runs: bool) -> None:
        """Record whether any servo runs, at `now_ns` of the monotonic clock."""
        if self._map is not None:
            self._map[:] = (_LINE % (now_ns, any_runs)).encode()


def rules(settings: Settings) -> Rules:
    """Return the supervisor's rules: the settings in ns, mV and hundredths of a degree."""
    return Rules(
        wire=called(settings.wire.name),
        timeout_ns=round(settings.watchdog.timeout_ms * NS_PER_MS),
        whole_robot=settings.watchdog.scope == "robot" or settings.starts_whole,
        starts_whole=settings.starts_whole,
        period_ns=ceil(NS_PER_S / settings.limits.leg_rate_hz),  # never above the limit
        start_wait_ns=START_WAIT_NS,
        start_pause_ns=round(settings.limits.start_stagger_ms * NS_PER_MS),
        joint_limits_cdeg={
            int(servo): (centidegrees(limits.min_deg), centidegrees(limits.max_deg))
            for servo, limits in settings.limits.servos.items()
        },
        avoid_cdeg=settings.spi.framing.avoid_cdeg,
        max_speed_cdeg_s={
            int(servo): centidegrees(limits.max_speed_deg_s) or 1  # 0 means no limit
            for servo, limits in settings.limits.servos.items()
            if limits.max_speed_deg_s
        },
        takeover_cdeg_s=centidegrees(settings.limits.takeover_deg_s) or ceil(settings.limits.takeover_deg_s),
        landing_ns=round(settings.watchdog.landing_ms * NS_PER_MS),
        landing_cdeg={int(servo): centidegrees(angle) for servo, angle in settings.watchdog.landing.items()},
        lease_required=settings.lease.required,
        lease_ttl_ns=round(settings.lease.ttl_ms * NS_PER_MS),
        buttons_required=settings.buttons.required,
        buttons_timeout_ns=round(settings.buttons.timeout_ms * NS_PER_MS),
        min_battery_mv=round(settings.safety.min_battery_v * 1000),
        max_tilt_cdeg=centidegrees(settings.safety.max_tilt_deg),
        power=bool(settings.power.interface),
        angles_first=settings.wire.has_uart,
    )


def run(
    settings: Settings,
    simulated: SimulatedParts,
    on_ready: Callable[[zenoh.Config], None] = lambda _: None,
) -> None:
    """Run the service until SIGTERM or SIGINT, then leave the process.

    `on_ready` is called with Zenoh's configuration once commands are accepted. Raises ConfigError for a wrong setting
    or file, SpiError if the bus does not open or no Stop is written, ZenohError if Zenoh does not open.
    """
    descriptors.ensure()
    realtime.prefer_process()
    realtime.limit_malloc_arenas()
    receive_each_session_alone()
    logs.set_up()
    logs.keep_stacks()
    if not simulated.controller:  # before the first frame
        try:
            effective.write(ForStops(settings.wire, settings.spi, settings.controller, settings.power))
        except (OSError, ValueError) as error:
            logger.warning("the settings in use cannot be written for a stop-servos by hand: %s", error)
    facts: dict[str, Any] = {
        "version": __version__,
        "simulated": simulated.controller,
        "framing": settings.framing,
        "timeout_ms": settings.watchdog.timeout_ms,
        **dict(zip(STOP_FACTS, take_note(), strict=False)),
    }

    async def serve(recorder: Recorder) -> ServiceEnd:
        return await _Service(settings, recorder, simulated).run(on_ready)

    # epoll and poll round a timer up to the next millisecond, which would delay Stops; select takes microseconds.
    with (
        closing(Recorder(settings, facts, time.monotonic_ns, time.time_ns)) as recorder,
        asyncio.Runner(loop_factory=lambda: asyncio.SelectorEventLoop(selectors.SelectSelector())) as runner,
    ):
        try:
            end = runner.run(serve(recorder))
        except GatewayError as error:  # after any other error the black box has no end
            recorder.ended(str(error))
            raise
        if end.failure is not None:
            recorder.ended(end.failure)
    end.leave()  # the interpreter's own exit would abort while a thread is inside Zenoh


class _Service:
    """The parts of one service, connected. For the loop's thread."""

    def __init__(self, settings: Settings, recorder: Recorder, simulated: SimulatedParts) -> None:
        """Make all parts that need no Zenoh session. Raises ConfigError if a file or certificate cannot be used."""
        # The servos file exists before systemd counts the service as active, when an upgrade reads it.
        loop, owner, self.servos = asyncio.get_running_loop(), Ownership(), ServosFile(runtime_directory())
        self.settings, self.recorder, self.simulated, self.loop, self.owner = settings, recorder, simulated, loop, owner
        self.end, self.notifier = ServiceEnd(loop, owner, recorder), SystemdNotifier()
        self.config = service_config(settings.zenoh)
        self.shut_out = revocation_state(self.config, settings)
        list_common_names(self.config, self.shut_out.common_names)
        if simulated.folder is not None:  # it has the socket of a simulated body
            from gateway.simulation.body import admit  # noqa: PLC0415  (a robot's first Stops do not wait for it)

            admit(self.config, simulated.folder)
        cas, _, known = self.shut_out
        if known is not None:
            names = ", ".join(sorted(known.common_names)) or "nobody"
            logger.info("list %d shuts out %s; it was signed on %s", known.number, names, f"{known.date:%Y-%m-%d}")
        self.checker = certs.proof.ProofChecker(cas, known) if cas else None
        if self.checker is not None and (fault := self.checker.clock_fault(wall_clock())):
            logger.warning(fault)
        found = state_directory(settings.state.path)
        state, handed_over = None if found is None else StateFolder(found), take_over()
        self.bus = wires.wire(settings, simulated)
        failed = partial(report_mistake, loop, "a thread failed")
        power, channel = settings.power, simulated.board_channel
        power = power if channel is None else replace(power, interface="slcan", channel=channel)
        self.line = PowerLine(power, failed, spare=descriptors.Spare()) if power.interface else None
        self.outbox = ZenohOutbox()
        self.conductor = Conductor(
            settings,
            Supervisor(replace(rules(settings), estop_kept=state is not None or handed_over is not None)),
            self.bus,
            self.outbox,
            loop,
            clock=time.monotonic_ns,
            recorder=recorder,
            owner=owner,
            line=self.line,
        )
        if self.line is not None:
            self.line.start()
        self.keeper = EstopKeeper(self.conductor, state, loop, handed_over)
        reports, forgotten = self.conductor.reports, "" if state is None else forgets(state.path)
        reports.simulated, reports.physics = simulated.controller, simulated.body_id
        reports.calibration_kept = state is not None and not forgotten
        if forgotten:
            lost = "calibration, revocations and the emergency stop are then lost (docs/robot.md)"
            logger.warning("%s is on %s, which a boot empties: %s", found, forgotten, lost)
        self.calibrations = Calibrations(self.conductor, state)
        self.revocations = Revocations(self.conductor, self.shut_out, self.end.begin_again)
        self.upkeep = Upkeep(self.config, self.show)
        if (first := self.upkeep.first_expiry) is not None:
            reports.certificate = CertificateReport(file=first.file.name, expires=first.end)

    async def run(self, on_ready: Callable[[zenoh.Config], None]) -> ServiceEnd:
        """Run from the first Stops to the end. Return why it ended."""
        conductor, end, closes = self.conductor, self.end, [self.keeper.flush]
        try:
            # Stops before Zenoh: servos that move at the start are stopped before any command can arrive.
            with self.owner:
                conductor.start()
            if self.bus.cycle is not None:
                cycle = partial(self.bus.cycle, self.owner, conductor.measured, conductor.bus_failed)
                cycles = in_thread("cycle", partial(run_cycles, cycle))
                cycles.add_done_callback(asyncio.Future.result)  # a mistake ends the service
            recorded = asyncio.wait((in_thread("black box", partial(self.recorder.open, self.owner)),), timeout=READ_S)
            opening = asyncio.gather(in_thread("open", self.open_zenoh), self.keeper.known(), recorded)
            ended = asyncio.ensure_future(end.requested.wait())
            await asyncio.wait((opening, ended), return_when=asyncio.FIRST_COMPLETED)
            if opening.done():
                session, *_ = opening.result()
                try:
                    closes += self.take_commands(session, on_ready)
                    await ended
                    self.beat.cancel()
                except Exception as error:  # commands may have been accepted before
                    self.loop.call_exception_handler({"message": "the start failed", "exception": error})
            self.notifier.stopping(anew=end.starts_anew)
            deadline = self.loop.time() + SHUTDOWN_S
            end.stopped = await stop_the_robot(conductor)
        finally:
            with self.owner:
                conductor.close()
        await close_within(deadline - self.loop.time(), closes)
        with self.owner:
            end.handed_over = {**self.keeper.hand_over(), **self.calibrations.hand_over()}
        return end

    def take_commands(
        self, session: zenoh.Session, on_ready: Callable[[zenoh.Config], None]
    ) -> list[Callable[[], None]]:
        """Take commands from this session. Return what closes all that was opened, in this order."""
        conductor = self.conductor
        self.outbox.open(session)
        with self.owner:  # the inbox's threads receive at once; they wait until the start is announced
            self.inbox = conductor.messages = self.inbox_of(session)
            conductor.reports.announce_start()
            self.keeper.announce_start()
            self.calibrations.publish()
        realtime.freeze_gc()
        # After Zenoh has opened: its threads inherit the priority of the thread that starts them, and must not get it.
        granted = realtime.prefer_thread(realtime.LOOP_PRIORITY)
        logger.info("real-time priority %s", "granted" if granted else "not allowed")
        on_ready(self.config)  # before the notification, on which `make run` prints its own lines
        self.notifier.ready("takes commands")
        self.upkeep.start(session)
        count = partial(setattr, conductor.metrics, "sessions")
        connection_limiter = ConnectionLimiter(session, count, self.shut_out.common_names)
        self.unknown_keys = UnknownKeys(session, self.simulated.body_id)
        self._beat_at(self.loop.time())
        conductor.on_mode = partial(self.loop.call_soon_threadsafe, self.beat_soon)
        closes = [self.outbox.close, connection_limiter.close, self.upkeep.close, self.inbox.close, session.close]
        return closes if self.line is None else [*closes, self.line.close]

    def show(self, status: str, missing: tuple[str, ...]) -> None:
        """Show a sentence in `systemctl status`, and these endpoints in the state. For any thread."""
        self.notifier.status(status)
        self.conductor.reports.missing_endpoints = missing

    def open_zenoh(self) -> zenoh.Session:
        """Open the metrics page and Zenoh. Wait for name servers, and for routers if the Zenoh file demands it."""
        metrics = self.settings.telemetry.metrics
        if metrics:
            from gateway.robot.runtime import prometheus  # noqa: PLC0415  (slow to load, and rarely used)

            self.upkeep.serve(metrics, partial(prometheus.serve, metrics, self.conductor))
        return self.upkeep.open()

    def inbox_of(self, session: zenoh.Session) -> Inbox:
        """Return what receives all messages of this session."""
        conductor, settings = self.conductor, self.settings
        conductor.reports.names_proved = self.checker is not None
        lease = LeaseAnswers(conductor, self.checker)
        button = ButtonAnswers(conductor, self.checker)
        answers: dict[str, Callable[[Reply], None]] = {
            key: partial(conductor.reports.answer, key)
            for key in (STATE, CONFIG, *((TELEMETRY,) if settings.measures else ()))
        }
        answers[CALIBRATION] = self.calibrations.answer
        return Inbox(
            session,
            self.loop,
            self.owner,
            on_wakeup=conductor.tick,
            on_estop=conductor.serve_estops,
            readers={
                **{each.key: each.note for each in (lease, button, self.calibrations, self.revocations)},
                **{key: partial(_answer, answer) for key, answer in answers.items()},
            },
            tokens={lease.key: conductor.supervisor.lease.holds, button.key: conductor.supervisor.buttons.knows},
            depth=put_depth(settings.limits.leg_rate_hz, settings.watchdog.timeout_ms),
            on_estop_received=self.estop_received,
        )

    def estop_received(self) -> None:
        """Do what an emergency stop needs besides its step. For any thread."""
        if self.line is not None:
            self.line.cut()
        self.keeper.received()

    # ---- the beat: timers instead of a task's sleep, which would have an idle loop turn once more for each beat

    def look_after_all(self, due_s: float) -> None:
        """Do what a beat has to do, and set the next one's timer if the receiver threads make progress.

        Measure the loop's lag since `due_s`, publish the reports that have a subscriber (changes of mode are published
        as they happen), and notify systemd. A beat owns the state for a moment: if another thread never releases the
        state, systemd gets no notification.
        """
        conductor, lag_ns = self.conductor, round((self.loop.time() - due_s) * 1e9)
        found = self.unknown_keys.poll()
        reports = {STATE: conductor.reports.publish, TELEMETRY: conductor.reports.publish_telemetry}
        wanted = [publish for key, publish in reports.items() if self.outbox.anyone_listens(key)]
        with self.owner:  # this also keeps reports in order: an older state must not follow a newer one
            conductor.metrics.loop_lag.record(lag_ns)
            conductor.recorder.beat(lag_ns)
            if found is not None:
                key, source, detail = found
                conductor.executor.reject_unread(key, (source, source), detail)
            for publish in wanted:
                publish()
        with self.owner:  # again, so that an emergency stop need not wait for both
            now_ns = conductor.record_alive()
            conductor.check_outside()
            at_rest = conductor.supervisor.legs.at_rest
        self.servos.write(now_ns, any_runs=not at_rest)
        with self.owner:
            progresses = self.inbox.makes_progress()
        if not progresses:
            self.end.because("a thread that takes commands has ended or is stuck")
        elif conductor.supply is not None and not conductor.supply.makes_progress():
            self.end.because("the thread that receives from the power board is stuck")
        else:
            self.notifier.alive()
            rests = not wanted and self.inbox.is_quiet and conductor.rests(REST_BEAT_S)
            period_s = REST_BEAT_S if rests else BEAT_S
            due_s = self.loop.time() + min(period_s, self.notifier.ping_period_s or period_s)
            self._beat_at(due_s)

    def beat_soon(self) -> None:
        """Bring the next beat forward: a servo may run now."""
        due_s = self.loop.time() + BEAT_S
        if self.beat.when() > due_s and not self.beat.cancelled():
            self.beat.cancel()
            self._beat_at(due_s)

    def _beat_at(self, due_s: float) -> None:
        self.beat = self.loop.call_at(due_s, self.look_after_all, due_s)


def _answer(answer: Callable[[Reply], None], _query: zenoh.Query, _ns: int, reply: Reply) -> OwnersTask:
    return partial(answer, reply)
