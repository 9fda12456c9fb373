"""The steps of `check --stops`. Each returns its figures, or raises FailedError or Skipped."""

import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final, NamedTuple

from gateway.model.frames import Frame, Op
from gateway.onboard.check.stops.bench import (
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
from gateway.onboard.check.stops.power import can_unplugged, confirmed_off, spi_unplugged
from gateway.onboard.check.stops.service import killed
from schemas.robot import LEGS
from schemas.telemetry import Cause, Kind, Mode, Reason

ANSWER_MS: Final = 100.0
"""How long the answer to an emergency stop may take, beyond that of any other question."""
TRAVEL_S: Final = 20.0
"""For 15° at 1° a second."""
STOP_SERVOS_S: Final = 20.0


class CheckStep(NamedTuple):
    """One step: what a person reads before it, and what does it."""

    name: str
    does: str
    run: Callable[[Bench], Figures]


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
        running = [servo for leg in state.legs for servo in leg.servos if servo.id == bench.motion.servo_id]
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
    moves = (seen for seen in bench.since(mark) if seen.moves)
    found = [seen.frame for seen in moves if not (of_others and seen.leg != bench.motion.leg)]
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
        demand(late_ms <= bench.late_ms + bench.answer_ms, f"it ran on for {late_ms:.0f} ms after {silent}")
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


def estop(bench: Bench) -> Figures:
    """An emergency stop while setpoints go on streaming, and its reset."""
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
    demand_rejected(bench.ask("start", bench.motion.start_deg), Reason.ESTOPPED, "a start in the emergency stop")
    mark = bench.mark()  # a setpoint may have been written between the first mark and the emergency stop
    demand_accepted(bench.reset(bench.estop), "the reset")
    bench.demand_no_motion(mark, "after the reset")
    return {"request_to_sixth_stop_us": latency_us, "request_to_answer_ms": took_ms, "stop_frames": len(LEGS)}


def _demand_six_stops(frames: list[WrittenFrame]) -> None:
    stops = caused(frames, Cause.ESTOP)
    legs = {seen.leg for seen in stops if not seen.moves}
    demand(legs == set(LEGS), f"Stops were written for the legs {sorted(legs)} only")
    after = [seen for seen in frames[frames.index(stops[0]) :] if seen.moves]
    demand(not after, f"{len(after)} frames moved a servo after the emergency stop")


def stop_servos(bench: Bench) -> Figures:
    """`stop-servos`, while the gateway runs."""
    state = bench.client.state()
    if state.simulated:
        raise Skipped("a simulated controller has no other way in")
    if not Path(state.spi.device).exists():
        raise Skipped(f"{state.spi.device} is not on this machine; run this on the robot")
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
    CheckStep("command", "starts {servos} at {start:g}°, sets {end:g}°, and stops again", command),
    CheckStep("silence", "starts {servos} and falls silent: the watchdog must {end_of_silence}", silence),
    CheckStep("estop", "engages the emergency stop while setpoints stream: six Stops, nothing after, a reset", estop),
    CheckStep("stop-servos", "runs stop-servos while the gateway runs and setpoints stream", stop_servos),
    CheckStep("restart", "kills the service while setpoints stream: stopped at once, and at its new start", killed),
    CheckStep("power", "engages the emergency stop: the power board must confirm that no servo is fed", confirmed_off),
    CheckStep(
        "spi-unplugged",
        "engages the emergency stop while the controller is unplugged: the power board must confirm it",
        spi_unplugged,
    ),
    CheckStep(
        "can-unplugged",
        "the power board is unplugged while {servos} runs: must be reported, and stopped over SPI",
        can_unplugged,
    ),
)
"""In their order. Each leaves all legs stopped, or `check --stops` does."""
