"""Builds and connects the service's parts, and runs them from start to end."""

import asyncio
import logging
import selectors
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from math import ceil
from pathlib import Path
from typing import TYPE_CHECKING, Any

import zenoh

from gateway import __version__
from gateway.allowance import NS_PER_MS, NS_PER_S
from gateway.host import descriptors, effective, logs, realtime
from gateway.host.directories import runtime_directory, state_directory
from gateway.host.mounts import forgets
from gateway.host.settings_reader import ForStops
from gateway.host.worker import in_thread
from gateway.model.black_box.format import STOP_FACTS
from gateway.model.frames import centidegrees
from gateway.own_command import command
from gateway.robot import wires
from gateway.robot.blackbox.recorder import Recorder
from gateway.robot.core.backlog import START_WAIT_NS
from gateway.robot.core.calibrating import ACCEPT_DEFAULT
from gateway.robot.core.leg import Rules
from gateway.robot.core.supervisor import Supervisor
from gateway.robot.host import calibration_file, stop_note
from gateway.robot.host.disk_writer import DiskWriter, report_mistake
from gateway.robot.host.ownership import Ownership
from gateway.robot.host.servos_file import ServosFile
from gateway.robot.host.systemd import SystemdNotifier
from gateway.robot.protocol import Wire
from gateway.robot.runtime.calibrations import Calibrations
from gateway.robot.runtime.conductor import Conductor
from gateway.robot.runtime.cycle import Cycle
from gateway.robot.runtime.estop_keeper import EstopKeeper
from gateway.robot.runtime.event_publisher import wall_clock
from gateway.robot.runtime.request_answers import ButtonAnswers, LeaseAnswers
from gateway.robot.runtime.revocations import Revocations
from gateway.robot.runtime.shutdown import SHUTDOWN_S, ServiceEnd, close_within, stop_the_robot
from gateway.robot.runtime.supply import supply_of
from gateway.robot.settings import Settings
from gateway.robot.spi.cyclic import CyclicBus
from gateway.robot.wires import SimulatedParts
from gateway.robot.zenoh_io.connection_limiter import ConnectionLimiter
from gateway.robot.zenoh_io.inbox import Inbox
from gateway.robot.zenoh_io.late_addresses import LateAddresses
from gateway.robot.zenoh_io.outbox import ZenohOutbox
from gateway.robot.zenoh_io.proofs import checker_of
from gateway.robot.zenoh_io.revoked import RevocationState, list_common_names, revocation_state
from gateway.robot.zenoh_io.rings import put_depth
from gateway.robot.zenoh_io.session import receive_each_session_alone, service_config
from gateway.robot.zenoh_io.unknown_keys import UnknownKeys
from gateway.robot.zenoh_io.upkeep import Upkeep
from schemas.keys import CALIBRATION, CONFIG, STATE, TELEMETRY

if TYPE_CHECKING:
    from gateway.certs.proof import ProofChecker

BEAT_S = 0.1
"""Period of a beat: measure the loop's lag, notify systemd, publish state and telemetry. It suits people who watch a
page. A systemd watchdog may need a shorter period."""

logger = logging.getLogger(__name__)


def _speed_cdeg_s(deg_s: float) -> int:
    """Return a speed in hundredths of a degree a second. Only 0 gives 0, since 0 means no limit."""
    return max(1, centidegrees(deg_s)) if deg_s else 0


def rules(settings: Settings) -> Rules:
    """Return the supervisor's rules: the settings in ns, mV and hundredths of a degree."""
    return Rules(
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
            int(servo): _speed_cdeg_s(limits.max_speed_deg_s)
            for servo, limits in settings.limits.servos.items()
            if limits.max_speed_deg_s
        },
        takeover_cdeg_s=_speed_cdeg_s(settings.limits.takeover_deg_s),
        landing_ns=round(settings.watchdog.landing_ms * NS_PER_MS),
        landing_cdeg={int(servo): centidegrees(angle) for servo, angle in settings.watchdog.landing.items()},
        lease_required=settings.lease.required,
        lease_ttl_ns=round(settings.lease.ttl_ms * NS_PER_MS),
        buttons_required=settings.buttons.required,
        buttons_timeout_ns=round(settings.buttons.timeout_ms * NS_PER_MS),
        min_battery_mv=round(settings.safety.min_battery_v * 1000),
        max_tilt_cdeg=centidegrees(settings.safety.max_tilt_deg),
        power=bool(settings.power.interface),
        angles_first=settings.wire.supply_starts,
    )


def _recorder(settings: Settings, *, simulated: bool) -> Recorder:
    facts: dict[str, Any] = {
        "version": __version__,
        "simulated": simulated,
        "framing": settings.framing,
        "timeout_ms": settings.watchdog.timeout_ms,
    }
    stops = stop_note.take()
    if stops is not None:
        facts |= dict(zip(STOP_FACTS, stops, strict=True))
    return Recorder(settings, facts, time.monotonic_ns, time.time_ns)


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
    if not simulated.controller:
        _show_settings(settings)  # before the first frame
    # epoll and poll round a timer up to the next millisecond, which would delay Stops; select takes microseconds.
    with (
        _recorder(settings, simulated=simulated.controller) as recorder,
        asyncio.Runner(loop_factory=lambda: asyncio.SelectorEventLoop(selectors.SelectSelector())) as runner,
    ):
        end = runner.run(_run(settings, recorder, simulated, on_ready))
        if end.failure is not None:
            recorder.ended(end.failure)
    end.leave()  # the interpreter's own exit would abort while a thread is inside Zenoh


def _configured(
    settings: Settings, folder: Path | None
) -> tuple[zenoh.Config, "ProofChecker | None", RevocationState | None]:
    """Return Zenoh's configuration; if it names a CA, also the checker of proofs and the revocations.

    `folder` has the socket of a simulated body. Raises ConfigError if the Zenoh file or a certificate cannot be used.
    """
    config = service_config(settings.zenoh)
    shut_out = revocation_state(config, settings)
    revoked = None if shut_out is None else shut_out.known
    list_common_names(config, revoked)
    if folder is not None:
        from gateway.simulation.body import admit  # noqa: PLC0415  (a robot's first Stops do not wait for it)

        admit(config, folder)
    if revoked is not None:
        names = ", ".join(sorted(revoked.common_names)) or "nobody"
        logger.info("list %d shuts out %s; it was signed on %s", revoked.number, names, f"{revoked.date:%Y-%m-%d}")
    elif shut_out is not None:
        logger.info("there is no list of revoked certificates")
    checker = checker_of(config, revoked)
    fault = None if checker is None else checker.clock_fault(wall_clock())
    if fault is not None:
        logger.warning(fault)
    return config, checker, shut_out


def _show_settings(settings: Settings) -> None:
    try:
        effective.write(ForStops(settings.wire, settings.spi, settings.controller, settings.power))
    except (OSError, ValueError) as error:
        logger.warning("the settings in use cannot be written for a stop-servos by hand: %s", error)


async def _run(
    settings: Settings,
    recorder: Recorder,
    simulated: SimulatedParts,
    on_ready: Callable[[zenoh.Config], None],
) -> ServiceEnd:
    # The servos file exists before systemd counts the service as active, when an upgrade reads it.
    loop, owner, servos = asyncio.get_running_loop(), Ownership(), ServosFile(runtime_directory())
    state, failed = state_directory(settings.state.path), partial(report_mistake, loop, "a thread failed")
    end, notifier = ServiceEnd(loop, owner, recorder), SystemdNotifier()
    config, checker, shut_out = _configured(settings, simulated.folder)
    bus = wires.wire(settings, simulated)
    supply = supply_of(settings, bus, simulated.board_channel, loop, owner, failed)
    outbox = ZenohOutbox()
    conductor = Conductor(
        settings,
        Supervisor(replace(rules(settings), estop_kept=state is not None)),
        bus,
        outbox,
        loop,
        clock=time.monotonic_ns,
        simulated=simulated.controller,
        physics=simulated.body_id,
        recorder=recorder,
        owner=owner,
        calibration_kept=_is_kept(state),
        supply=supply,
    )
    keeper, calibrations = EstopKeeper(conductor, state, loop), _calibrations(settings, conductor, loop)
    revocations = Revocations(conductor, shut_out, loop, end.begin_again)
    try:
        # Stops before Zenoh: servos that move at the start are stopped before any command can arrive.
        with owner:
            conductor.start()
            recorder.open()
        _go_on(bus, conductor, settings, failed, simulated=simulated.controller)
        opening = asyncio.gather(in_thread("open", partial(_open, settings, config, conductor)), keeper.known())
        ended = asyncio.ensure_future(end.wait())
        await asyncio.wait((opening, ended), return_when=asyncio.FIRST_COMPLETED)
        if not opening.done():
            notifier.stopping()
            await stop_the_robot(conductor, bus)
            keeper.flush()
            end.leave()
        ended.cancel()
        (session, late), _ = opening.result()
        outbox.open(session)
        with owner:  # the inbox's threads receive at once; they wait until the conductor is connected
            inbox = _inbox(session, loop, conductor, checker, settings, calibrations, revocations)
        realtime.freeze_gc()
        # After Zenoh has opened: its threads inherit the priority of the thread that starts them, and must not get it.
        logger.info(
            "real-time priority %s", "granted" if realtime.prefer_thread(realtime.LOOP_PRIORITY) else "not allowed"
        )
        with owner:
            for part in (conductor.reports, keeper, calibrations):
                part.announce_start()
        on_ready(config)  # before the notification, on which `make run` prints its own lines
        notifier.ready("takes commands")
        connection_limiter, upkeep = _attendants(session, config, conductor, notifier, shut_out, late)
        beat = _Beat(
            loop,
            notifier,
            conductor,
            inbox,
            outbox,
            _reports(settings, conductor),
            UnknownKeys(session, simulated.body_id),
            servos,
            end,
        )
        loop.call_soon(beat.begin)
        await end.wait()
        notifier.stopping(anew=end.starts_anew)
        beat.cancel()
        deadline = loop.time() + SHUTDOWN_S
        await stop_the_robot(conductor, bus)
        with owner:
            conductor.close()
        await close_within(
            deadline - loop.time(),
            end.leave,
            keeper.flush,
            outbox.close,
            connection_limiter.close,
            upkeep.close,
            inbox.close,
            session.close,
            *(() if supply is None else (supply.end,)),
        )
    finally:
        with owner:
            conductor.close()
        notifier.close()
    return end


def _is_kept(state: Path | None) -> bool:
    """Return whether the state directory survives a boot. Log a warning if a boot empties it."""
    kind = "" if state is None else forgets(state)
    if kind:
        logger.warning(
            "%s is on %s, which a boot empties: calibration, revocations and the emergency stop are then lost "
            "(docs/robot.md)",
            state,
            kind,
        )
    return state is not None and not kind


def _go_on(
    bus: Wire, conductor: Conductor, settings: Settings, failed: Callable[[Exception], None], *, simulated: bool
) -> None:
    if isinstance(bus, CyclicBus):
        Cycle(bus, conductor, failed).start()
    wires.warn_of_driver(settings.wire, settings.spi, simulated=simulated)


def _calibrations(settings: Settings, conductor: Conductor, loop: asyncio.AbstractEventLoop) -> Calibrations:
    """Load the calibration from its file. Without a usable file no servo can be started, but the service runs: Stops
    need no calibration."""
    path = calibration_file.path_of(settings)
    if path is None:
        return Calibrations(conductor, None, loop)
    calibration, fault = calibration_file.load(path)
    conductor.supervisor.calibrating.load(calibration, fault)
    if fault is not None:
        logger.warning("%s; nothing is started until `%s`", fault, command(ACCEPT_DEFAULT))
    disk = DiskWriter("keep calibration", loop, conductor.owner)
    return Calibrations(conductor, lambda new, then: disk.write(partial(calibration_file.write, path, new), then), loop)


def _open(settings: Settings, config: zenoh.Config, conductor: Conductor) -> tuple[zenoh.Session, LateAddresses]:
    """Open the metrics page and Zenoh. Wait for name servers, and for routers if the Zenoh file demands it."""
    late, metrics = LateAddresses(conductor.reports.has_missing), settings.telemetry.metrics
    if metrics:
        from gateway.robot.runtime import prometheus  # noqa: PLC0415  (slow to load, and rarely used)

        late.serve(metrics, partial(prometheus.serve, metrics, conductor))
    return late.open(config), late


def _inbox(
    session: zenoh.Session,
    loop: asyncio.AbstractEventLoop,
    conductor: Conductor,
    checker: "ProofChecker | None",
    settings: Settings,
    calibrations: Calibrations,
    revocations: Revocations,
) -> Inbox:
    lease = LeaseAnswers(conductor, settings.lease.ttl_ms, checker)
    button = ButtonAnswers(conductor, settings.buttons, checker)
    inbox = Inbox(
        session,
        loop,
        conductor.owner,
        on_wakeup=conductor.tick,
        on_estop=conductor.serve_estops,
        readers={
            **{each.key: each.note for each in (lease, button, calibrations, revocations)},
            STATE: lambda _query, _ns, reply: partial(conductor.reports.answer_state, reply),
            CONFIG: lambda _query, _ns, reply: partial(conductor.reports.answer_config, reply),
            CALIBRATION: lambda _query, _ns, reply: partial(calibrations.answer, reply),
            **(
                {TELEMETRY: lambda _query, _ns, reply: partial(conductor.telemetry.answer, reply)}
                if settings.measures
                else {}
            ),
        },
        tokens={lease.key: conductor.supervisor.lease.holds, button.key: conductor.supervisor.buttons.knows},
        depth=put_depth(settings.limits.leg_rate_hz, settings.watchdog.timeout_ms),
        on_estop_received=None if conductor.supply is None else conductor.supply.cut_early,
    )
    conductor.connect(inbox)
    return inbox


def _attendants(
    session: zenoh.Session,
    config: zenoh.Config,
    conductor: Conductor,
    notifier: SystemdNotifier,
    shut_out: RevocationState | None,
    late: LateAddresses,
) -> tuple[ConnectionLimiter, Upkeep]:
    upkeep = Upkeep(session, config, notifier.status, wall_clock, late)
    conductor.reports.certificate = upkeep.certificate
    revoked = frozenset() if shut_out is None or shut_out.known is None else shut_out.known.common_names
    return ConnectionLimiter(session, conductor.metrics.count_sessions, revoked), upkeep


def _reports(settings: Settings, conductor: Conductor) -> dict[str, Callable[[], None]]:
    measured = {TELEMETRY: conductor.telemetry.publish} if settings.measures else {}
    return {STATE: conductor.reports.publish, **measured}


@dataclass
class _Beat:
    """At each beat: measure the loop's lag, detect `stop-servos`, publish the reports that have a subscriber.

    Notify systemd if the loop and the receiver threads make progress. A beat owns the state for a moment: if another
    thread never releases the state, systemd gets no notification. Changes of mode are published as they happen.

    Timers instead of a task's sleep: an idle loop then turns once for each beat, and not twice.
    """

    loop: asyncio.AbstractEventLoop
    notifier: SystemdNotifier
    conductor: Conductor
    inbox: Inbox
    outbox: ZenohOutbox
    reports: Mapping[str, Callable[[], None]]
    unknown_keys: UnknownKeys
    servos: ServosFile
    end: ServiceEnd
    _due_s: float = field(default=0.0, init=False)
    _timer: asyncio.TimerHandle | None = field(default=None, init=False)

    def begin(self) -> None:
        """Look after all parts, and set the timer of the next beat."""
        conductor, supply = self.conductor, self.conductor.supply
        with conductor.owner:
            now_ns = conductor.record_alive()
            conductor.check_outside()
            at_rest = conductor.supervisor.legs.at_rest
        self.servos.write(now_ns, any_runs=not at_rest)
        if not self.inbox.receives:
            self.end.because("a thread that waits for commands has ended")
        elif not self.inbox.makes_progress():
            self.end.because("a thread that takes commands is stuck")
        elif supply is not None and not supply.makes_progress():
            self.end.because("the thread that receives from the power board is stuck")
        else:
            self.notifier.alive()
            period_s = min(BEAT_S, self.notifier.ping_period_s or BEAT_S)
            self._due_s = self.loop.time() + period_s
            self._timer = self.loop.call_at(self._due_s, self._beat)

    def cancel(self) -> None:
        if self._timer is not None:
            self._timer.cancel()

    def _beat(self) -> None:
        conductor, lag_ns = self.conductor, round((self.loop.time() - self._due_s) * 1e9)
        found = self.unknown_keys.poll()
        wanted = [publish for key, publish in self.reports.items() if self.outbox.anyone_listens(key)]
        with conductor.owner:  # this also keeps reports in order: an older state must not follow a newer one
            conductor.metrics.loop_lag.record(lag_ns)
            conductor.recorder.beat(lag_ns)
            if found is not None:
                conductor.executor.reject_unread(*found)
            for publish in wanted:
                publish()
        self.begin()
