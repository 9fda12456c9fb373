"""The steps of the drill. Each returns its figures, or raises FailedError or Skipped."""

import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final, NamedTuple

from gateway.model.frames import Frame, Op
from gateway.people.client.blocking import Client
from gateway.people.tools.drill.bench import (
    EVIDENCE_S,
    QUIET_S,
    SETPOINT_PERIOD_S,
    STREAM_S,
    Bench,
    FailedError,
    Figures,
    Skipped,
    WrittenFrame,
    caused,
    demand,
    demand_accepted,
    demand_rejected,
)
from gateway.people.tools.drill.cut_link import CutLink
from gateway.people.tools.drill.power import can_unplugged, confirmed_off, spi_unplugged
from gateway.people.tools.drill.service import killed
from gateway.people.tools.drill.watching import falls_silent
from gateway.zenoh_config import client_config
from schemas.robot import LEGS
from schemas.telemetry import Cause, Kind, Mode, Reason

ANSWER_MS: Final = 100.0
"""How long the answer to an emergency stop may take, beyond that of any other question."""
TRAVEL_S: Final = 20.0
"""For 15° at 1° a second."""
LEARN_S: Final = 0.6
"""A gateway learns a sender's clock from setpoints that were not delayed."""
HELD_S: Final = 1.5
"""What a cut link holds is so old: three times the default of `limits.max_age_ms`."""
KEPT_MS: Final = 30_000
"""How long the gateway keeps the link of a client that sends nothing."""
STOP_SERVOS_S: Final = 20.0


class DrillStep(NamedTuple):
    """One step of the drill."""

    name: str
    does: str
    run: Callable[[Bench], Figures]
    shows: str
    """The claim of the safety case (docs/safety.md) that it shows on this robot."""
    drives: bool = True
    """Under the lease, so that nobody else moves the robot meanwhile."""


def command(bench: Bench) -> Figures:
    """Start, set and stop; exactly their frames are written."""
    mark = bench.mark()
    begun_s = time.monotonic()
    bench.start()
    start_ms = (time.monotonic() - begun_s) * 1000
    demand_accepted(bench.ask("set", bench.motion.end_deg), "a set")
    on_the_way = _arrive(bench)
    bench.stop()
    wanted = [bench.frame(Op.START, bench.motion.start_deg), bench.frame(Op.SET, bench.motion.end_deg)]
    _demand_frames(bench, mark, wanted, on_the_way=on_the_way)
    bench.demand_no_motion(len(bench.frames), "after the Stop")
    return {"start_to_answer_ms": start_ms, "frame": wanted[0].to_bytes().hex()}


def _arrive(bench: Bench) -> bool:
    """Set the servos until they arrive. Returns whether they took several steps, by their max_speed_deg_s."""
    end_s = time.monotonic() + TRAVEL_S
    low_deg, high_deg = sorted((bench.motion.start_deg, bench.motion.end_deg))
    on_the_way = False
    while True:
        state = bench.client.state()
        demand(
            bench.running(state) == bench.motion.started_ids,
            f"these servos were started: {bench.motion.started_ids}; these run: {bench.running(state)}",
        )
        running = [servo for leg in state.legs for servo in leg.servos if servo.id in bench.motion.servo_ids]
        angles = [servo.angle_deg for servo in running]
        if set(angles) == {bench.motion.end_deg}:
            return on_the_way
        on_the_way = {servo.target_deg for servo in running} == {bench.motion.end_deg} and all(
            angle is not None and low_deg <= angle <= high_deg for angle in angles
        )
        shown = ", ".join(map(str, angles))
        demand(on_the_way and time.monotonic() < end_s, f"set to {bench.motion.end_deg:g}°, and the state has {shown}")
        demand_accepted(bench.ask("set", bench.motion.end_deg), "a set")
        time.sleep(SETPOINT_PERIOD_S)


def _demand_frames(bench: Bench, mark: int, wanted: list[Frame], *, on_the_way: bool) -> None:
    if not bench.frames_published:
        return
    stopped = bench.wait(
        lambda: any(not seen.moves and seen.leg == bench.motion.leg for seen in bench.since(mark)), EVIDENCE_S
    )
    of_others = bench.motion.holding  # which hold
    found = [
        seen.frame for seen in bench.since(mark) if seen.moves and not (of_others and seen.leg != bench.motion.leg)
    ]
    shown = ", ".join(frame.to_bytes().hex() for frame in found) or "none"
    if on_the_way and found and _never_back(found):
        found = [found[0], found[-1]]
    demand(found == wanted, f"these frames moved it: {shown}; wanted: {', '.join(f.to_bytes().hex() for f in wanted)}")
    demand(stopped, "no Stop was written")


def _never_back(frames: list[Frame]) -> bool:
    """Whether these are one start and then sets of the same servos, whose angles go one way only."""
    if len({tuple(servo_id for servo_id, _ in frame.servos) for frame in frames}) != 1:
        return False
    if any(command.op is not Op.SET for frame in frames[1:] for _, command in frame.servos):
        return False
    angles = [[command.angle_cdeg for _, command in frame.servos] for frame in frames]
    ways = [list(way) for way in zip(*angles, strict=True)]
    return all(way in (sorted(way), sorted(way, reverse=True)) for way in ways)


def set_while_stopped(bench: Bench) -> Figures:
    """A set for a stopped servo is rejected, and moves nothing."""
    mark = bench.mark()
    ack = bench.ask("set", bench.motion.end_deg)
    demand_rejected(ack, Reason.SERVO_STOPPED, "a set for a servo that does not run")
    bench.demand_no_motion(mark, "after the rejected set")
    return {"reason": str(ack.reason)}


def silence(bench: Bench) -> Figures:
    """Start, and send nothing more."""
    state = bench.client.state()
    timeout_ms, before = state.watchdog.stops_after_ms, state.watchdog.expirations
    silent, figures = f"{state.watchdog.timeout_ms:g} ms of silence", {"timeout_ms": state.watchdog.timeout_ms}
    if state.watchdog.landing_ms:
        silent += f" and {state.watchdog.landing_ms:g} ms of landing"
        figures["landing_ms"] = state.watchdog.landing_ms
    mark = bench.mark()
    bench.start()
    begun_s = time.monotonic()
    stopped = bench.wait(lambda: not bench.running(), timeout_ms / 1000 + 1)
    took_ms = (time.monotonic() - begun_s) * 1000
    demand(stopped, f"it still runs, {took_ms:.0f} ms after its last command; it was to stop after {silent}")
    demand(bench.client.state().watchdog.expirations > before, "it stopped, but not by the watchdog")
    if not bench.frames_published:
        late_ms = took_ms - timeout_ms - bench.answer_ms
        demand(
            late_ms <= bench.late_ms + bench.answer_ms,
            f"it ran on for {late_ms:.0f} ms after {silent}",
        )
        return {**figures, "stopped_after_ms_by_state": took_ms}

    def watchdog_stops() -> list[WrittenFrame]:
        ours = caused(bench.since(mark), Cause.WATCHDOG)  # and those of a landing
        return [seen for seen in ours if seen.leg == bench.motion.leg and not seen.moves]

    bench.wait(watchdog_stops, EVIDENCE_S)
    started = [seen for seen in caused(bench.since(mark), Cause.COMMAND) if seen.moves]
    stops = watchdog_stops()
    demand(started and stops, "no Stop of the watchdog was written for the leg")
    late_us = (stops[0].at_ns - started[-1].at_ns) / 1000 - timeout_ms * 1000
    demand(late_us <= bench.late_ms * 1000, f"the Stop came {late_us / 1000:.1f} ms after {silent}")
    demand(late_us >= -bench.late_ms * 1000, f"the Stop came {-late_us / 1000:.1f} ms before the end of {silent}")
    time.sleep(QUIET_S)
    later = [seen for seen in bench.since(mark) if seen.at_ns > stops[0].at_ns and seen.leg == bench.motion.leg]
    repeats = caused(later, Cause.REPEAT)
    return {**figures, "later_us": late_us, "repeats": len(repeats)}


def estop_in_stream(bench: Bench) -> Figures:
    """An emergency stop, while setpoints go on streaming."""
    bench.start()
    with bench.streaming():
        time.sleep(STREAM_S)
        demand(bench.running(), "the leg does not run in a stream of setpoints")
        mark = bench.mark()
        begun_s = time.monotonic()
        ack = bench.client.estop()
        took_ms = (time.monotonic() - begun_s) * 1000
        time.sleep(STREAM_S)
    bench.estop = ack.estop or 0
    state = bench.client.state()
    demand(not bench.running(state), f"servos run after the emergency stop: {bench.running(state)}")
    demand(state.mode == Mode.ESTOPPED, f"the mode is {state.mode} after the emergency stop")
    demand(ack.stop_frames == len(LEGS), f"{ack.stop_frames} Stops were written, not {len(LEGS)}")
    latency_us = ack.latency_us or 0.0
    demand(latency_us <= bench.late_ms * 1000, f"the sixth Stop came {latency_us / 1000:.1f} ms after the request")
    limit_ms = ANSWER_MS + bench.answer_ms
    demand(took_ms <= limit_ms, f"the answer took {took_ms:.1f} ms, where any other takes {bench.answer_ms:.1f} ms")
    if bench.frames_published:
        _demand_six_stops(bench.since(mark))
    return {"request_to_sixth_stop_us": latency_us, "request_to_answer_ms": took_ms, "stop_frames": len(LEGS)}


def _demand_six_stops(frames: list[WrittenFrame]) -> None:
    stops = caused(frames, Cause.ESTOP)
    legs = {seen.leg for seen in stops if not seen.moves}
    demand(legs == set(LEGS), f"Stops were written for the legs {sorted(legs)} only")
    after = [seen for seen in frames[frames.index(stops[0]) :] if seen.moves]
    demand(not after, f"{len(after)} frames moved a servo after the emergency stop")


def rejected_until_reset(bench: Bench) -> Figures:
    """Starts are rejected, and only a reset of the latest emergency stop leaves it."""
    mark = bench.mark()
    if bench.client.state().mode != Mode.ESTOPPED:
        bench.estop = bench.client.estop().estop or 0
    ack = bench.ask("start", bench.motion.start_deg)
    demand_rejected(ack, Reason.ESTOPPED, "a start while the emergency stop is engaged")
    older = bench.reset(bench.estop - 1)
    demand(
        not older.accepted, f"a reset for the emergency stop {bench.estop - 1} left the emergency stop {bench.estop}"
    )
    bench.demand_no_motion(mark, "while the emergency stop is engaged")
    demand_accepted(bench.reset(bench.estop), "the reset")
    return {"estop": bench.estop}


def nothing_after_reset(bench: Bench) -> Figures:
    """The stream goes on after the reset, and moves nothing."""
    if bench.client.state().mode != Mode.ESTOPPED:
        bench.start()
        bench.estop = bench.client.estop().estop or 0
        time.sleep(QUIET_S)  # its frames are here, so that what comes from now on comes after the reset
    mark = bench.mark()
    demand_accepted(bench.reset(bench.estop), "the reset")
    with bench.streaming():
        time.sleep(STREAM_S)
        ack = bench.ask("set", bench.motion.start_deg)
        demand(ack.reason == Reason.SERVO_STOPPED, f"a set after the reset was answered: {ack.reason or 'accepted'}")
        bench.demand_no_motion(mark, "after the reset")
    return {"setpoints_without_effect": round(STREAM_S * 50)}


def queue_of_a_cut_link(bench: Bench) -> Figures:
    """Starts that a cut link holds back do not move the leg when it is there again."""
    source = f"{bench.client.name} (cut link)"
    with CutLink(_dialled(bench)) as link, _through(bench, link, source) as far, link.dropped_on_error():
        ack = far.ask(bench.motion.key, bench.payload("start", bench.motion.start_deg))
        if ack.reason == Reason.NO_LEASE:
            raise Skipped("lease.required is set, and a lease ends behind a cut link anyway")
        demand_accepted(ack, "a start")
        with bench.streaming(far):
            time.sleep(LEARN_S)
        link.hold()
        with bench.streaming(far, op="start"):
            time.sleep(STREAM_S)
        timeout_s = bench.client.state().watchdog.stops_after_ms / 1000
        if timeout_s > HELD_S:
            bench.stop()  # the link holds the commands for long enough anyway
        demand(bench.wait(lambda: not bench.running(), timeout_s + 1), "the leg runs on behind the cut link")
        time.sleep(HELD_S)
        mark, events = bench.mark(), len(bench.events)
        link.fix()
        stale = bench.wait(
            lambda: any(event.reason == Reason.STALE and event.source == source for event in bench.events[events:]),
            EVIDENCE_S / 2,
        )
        bench.demand_no_motion(mark, f"once the link was there again, with starts that were {HELD_S:g} s old")
        demand(stale, "nothing old was rejected; is limits.max_age_ms 0, or above 1500?")
    return {"held_s": HELD_S}


def _dialled(bench: Bench) -> str:
    """Where the drill's own link leads."""
    endpoint = next((str(link.dst) for link in bench.client.session.info.links()), "")
    demand(endpoint, "there is no link to the gateway any more")
    if endpoint.partition("/")[0] not in ("tcp", "tls"):
        raise Skipped(f"the drill can put itself into TCP and TLS only, and the link to the gateway is {endpoint}")
    return endpoint


@contextmanager
def _through(bench: Bench, link: CutLink, source: str) -> Iterator[Client]:
    """A client with the drill's certificate, through that link.

    The link is on this machine, for which the gateway's certificate need not be good: its name is not compared. It
    must still be of the CA, and the drill's own link to the same address has compared it. The gateway gives this client
    up later than the second that `certs` sets, after which it would drop what the link holds, and prove nothing.
    """
    config = client_config(link.endpoint, bench.reaches["zenoh_config"])
    config.insert_json5("transport/link/tx/lease", str(KEPT_MS))
    config.insert_json5("transport/link/tls/verify_name_on_connect", "false")
    with TemporaryDirectory() as folder:
        file = Path(folder) / "cut-link.json5"
        file.touch(0o600)
        file.write_text(str(config), encoding="utf-8")
        with Client(zenoh_config=file, source=source, timeout_s=EVIDENCE_S) as far:
            yield far


def lease_keeps_others_out(bench: Bench) -> Figures:
    """While the drill drives, nobody else moves the robot, and everybody stops it."""
    holder = bench.client.state().lease.holder
    if holder is None:
        raise Skipped("this gateway knows no lease, or gives the drill none")
    with Client(**bench.reaches, source=f"{bench.client.name} (somebody else)", timeout_s=EVIDENCE_S) as other:
        mark = bench.mark()
        payload = {
            name: value for name, value in bench.payload("start", bench.motion.start_deg).items() if name != "lease"
        }
        ack = other.ask(bench.motion.key, payload)
        demand_rejected(ack, Reason.NOT_HOLDER, "somebody else's start")
        bench.demand_no_motion(mark, "after somebody else's start")
        bench.start()
        demand_accepted(other.stop(), "somebody else's Stop")
        bench.demand_no_motion(bench.mark(), "after somebody else's Stop")
    return {"holder": holder}


def stop_servos(bench: Bench) -> Figures:
    """`stop-servos`, while the gateway runs."""
    state = bench.client.state()
    if state.simulated:
        raise Skipped("a simulated controller has no other way in")
    if not Path(state.spi.device).exists():
        raise Skipped(f"{state.spi.device} is not on this machine; run the drill on the robot")
    bench.start()
    with bench.streaming():
        time.sleep(STREAM_S)
        mark, events = bench.mark(), len(bench.events)
        begun_s = time.monotonic()
        command = [sys.executable, "-m", "gateway", "stop-servos", *bench.config]
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=STOP_SERVOS_S, check=False)
        except subprocess.TimeoutExpired as error:
            raise FailedError(f"stop-servos did not end within {STOP_SERVOS_S:g} s") from error
        took_ms = (time.monotonic() - begun_s) * 1000
        demand(done.returncode == 0, f"stop-servos ended with {done.returncode}: {done.stderr.strip()}")
        noticed = bench.wait(
            lambda: any(event.kind == Kind.STOPPED_OUTSIDE for event in bench.events[events:]), EVIDENCE_S
        )
        demand(noticed, "the gateway did not notice it")
        after = [seen for seen in bench.since(mark) if seen.cause == Cause.REPEAT]
        demand(after or not bench.frames_published, "the gateway wrote no Stops of its own")
        bench.demand_no_motion(bench.mark(), "after stop-servos")
    return {"took_ms": took_ms}


STEPS: Final = (
    DrillStep(
        "command", "starts {servos} at {start:g}°, sets {end:g}°, and stops again", command, "only-a-start-energises"
    ),
    DrillStep(
        "set-while-stopped",
        "sets {servos}, which is stopped: must be rejected",
        set_while_stopped,
        "only-a-start-energises",
    ),
    DrillStep(
        "silence", "starts {servos} and falls silent: the watchdog must {end_of_silence}", silence, "silence-stops"
    ),
    DrillStep(
        "estop",
        "engages the emergency stop while setpoints stream: six Stops, and nothing after",
        estop_in_stream,
        "estop-always",
    ),
    DrillStep(
        "until-reset",
        "starts {servos} in the emergency stop: must be rejected until a reset",
        rejected_until_reset,
        "restart-asks",
    ),
    DrillStep(
        "after-reset", "goes on streaming after the reset: nothing may move", nothing_after_reset, "restart-asks"
    ),
    DrillStep(
        "cut-link",
        "cuts a link of its own and joins it again, with old starts in it: must be rejected",
        queue_of_a_cut_link,
        "old-commands-move-nothing",
        drives=False,
    ),
    DrillStep(
        "lease",
        "somebody else starts {servos} (must be rejected) and stops it",
        lease_keeps_others_out,
        "one-driver",
    ),
    DrillStep(
        "button",
        "its stop button falls silent while setpoints stream: all legs must stop, and stay so once it is back",
        falls_silent,
        "somebody-watches",
    ),
    DrillStep(
        "stop-servos", "runs stop-servos while the gateway runs and setpoints stream", stop_servos, "death-stops"
    ),
    DrillStep(
        "restart",
        "kills the service while setpoints stream: stopped at once, and again at its new start",
        killed,
        "death-stops",
    ),
    DrillStep(
        "power",
        "engages the emergency stop: the power board must confirm that no servo is fed",
        confirmed_off,
        "estop-always",
    ),
    DrillStep(
        "spi-unplugged",
        "engages the emergency stop while the controller is unplugged: the power board must confirm it",
        spi_unplugged,
        "estop-always",
    ),
    DrillStep(
        "can-unplugged",
        "the power board is unplugged while {servos} runs: must be reported, and stopped over SPI",
        can_unplugged,
        "bus-fault-stops",
    ),
)
"""In their order. Each leaves all legs stopped, or the drill does."""
