"""`check --stops`: prove on this robot, step by step, that it stops. At the end everything is stopped."""

import re
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from itertools import dropwhile
from pathlib import Path
from typing import Final

from gateway.errors import ConfigError, GatewayError
from gateway.model.frames import Frame, OneServo, Op, ServoOp, centidegrees
from gateway.onboard.check.move import STREAM_S, Bench, StopsOptions
from gateway.onboard.check.table import SERVICE, CheckStep, FailedError, Skipped, conclude, demand, ms_since, shown
from gateway.people.client.blocking import Client
from gateway.people.commands.moving import ServoMotion, consent, lying, ready, stopped_after
from gateway.people.commands.reach import Connection, me, show_differences
from gateway.people.terminal import ask, hint, on_end_signals
from schemas.gateway_state import PowerReport
from schemas.robot import LEGS
from schemas.words import Cause, Kind, Mode, Reason

_START_DEG, _AGAIN_S = 90.0, 0.02
EVIDENCE_S: Final = 5.0
_ANSWER_MS: Final = 100.0  # the answer to an emergency stop, beyond that to any other question
_PROGRAM_S: Final = 20.0  # for 15° at 1° a second, stop-servos, systemctl, and a new start of the service
_SAME_START_S: Final = 15.0  # from a process's start to that of its uptime: a slow board loads Python
_REST_S: Final = 3.0  # after a reset the board's errors are deleted, for 2 s at most
_SILENT_MS: Final = 200.0  # a power board that is silent for this long is reported
_PLUGGED_S: Final = 60.0  # for a person to unplug something

Figures = dict[str, float | int | str]
"""A step's measurements. Their names end with the unit."""


def stops(connect: Connection, options: StopsOptions) -> int:
    """Do the steps. Return the exit code.

    Raises ConfigError if nothing may be moved, and ZenohError if no gateway answers, also between steps.
    """
    names = [step.name for step in STEPS]
    if unknown := set(options.only) - set(names):
        raise ConfigError(f"no step {', '.join(sorted(unknown))}; there are {', '.join(names)}")
    steps = [step for step in STEPS if not options.only or step.name in options.only]
    outcomes: list[dict[str, object]] = []
    with connect() as client:
        state = ready(client)
        show_differences(options.config)
        motion = ServoMotion(10 * options.leg + 1, _START_DEG, lying(client, state) if state.wire.whole_robot else {})
        bench = Bench(client, motion, options)
        if not state.simulated:
            consent(motion, state, agreed=options.agreed)
        bench.listen()  # no motion yet: without the right to command it ends here
        if not bench.frames_published:
            hint("The gateway publishes no frames (telemetry.frames), so the check measures from its state.")
        with _ended_stopped(bench):
            for number, step in enumerate(steps, 1):
                hint(f"{number}/{len(steps)} {step.name}: {step.does} …")
                bench.forget()
                held = client.lease(source=me())
                outcomes.append(step.outcome(bench, held, quiet=options.as_json))
                with suppress(GatewayError):  # the end tries again, and reports it
                    bench.rest()
    failed = [str(outcome["step"]) for outcome in outcomes if outcome["result"] == "FAIL"]
    passed = len(outcomes) == len(steps) and not failed
    end = "all passed" if passed else f"NOT passed: {', '.join(failed) or 'not finished'}"
    return conclude(end, well=passed, as_json={"steps": outcomes} if options.as_json else None)


@contextmanager
def _ended_stopped(bench: Bench) -> Iterator[None]:
    """Stop all legs at each end, also by a signal, and print a sentence about it."""
    ending = False  # then no Ctrl-C costs the Stop that the first one asks for

    def end() -> None:
        if not ending:  # each raises: a Zenoh callback may have swallowed the first, which is delivered again then
            raise KeyboardInterrupt

    def stop() -> str:
        bench.rest()
        running = ", ".join(map(str, bench.running()))
        return f"Servos still run: {running}: switch their power off." if running else "All legs are stopped."

    with on_end_signals(end), stopped_after("all legs are", stop):
        try:
            yield
        except KeyboardInterrupt:
            ending = True
            hint("The check was ended.")
        finally:
            ending = True


# ---- the steps: each returns its figures, or raises FailedError or Skipped


def command(bench: Bench) -> Figures:
    """Start, set and stop: exactly their frames are written, in one direction."""
    motion, begun_s = bench.motion, time.monotonic()
    bench.start()
    start_ms, angle_deg = ms_since(begun_s), motion.start_deg
    while angle_deg != motion.end_deg:  # several steps where max_speed_deg_s limits it
        demand(ms_since(begun_s) < _PROGRAM_S * 1000, f"set to {motion.end_deg:g}°, and the state has {angle_deg}")
        bench.ask("set", motion.end_deg)
        time.sleep(_AGAIN_S)
        running = bench.running()
        demand([*running] == motion.started_ids, f"of {motion.started_ids}, which were started, run {[*running]}")
        angle_deg = running[motion.servo_id] or 0.0
    bench.demand(bench.client.stop(), "a Stop")
    if bench.frames_published:
        stopped = bench.wait(lambda: bench.caused(Cause.COMMAND, stops=True), EVIDENCE_S)
        moves = [frame for _, frame in bench.frames if not frame.is_stop]
        demand(_as_commanded(bench, moves), f"these frames moved it: {[each.data.hex() for each in moves]}")
        demand(stopped, "no Stop was written")
    bench.demand_no_motion("after the Stop")
    return {"start_to_answer_ms": start_ms}


def _as_commanded(bench: Bench, moves: list[Frame]) -> bool:
    """Return whether the frames start the servo, set it to the end in one direction, and hold all other servos."""
    motion, ops = bench.motion, [pair for frame in moves for pair in frame.servos]
    own = [op for servo_id, op in ops if servo_id == motion.servo_id]
    ends = (ServoOp(Op.START, centidegrees(motion.start_deg)), ServoOp(Op.SET, centidegrees(motion.end_deg)))
    wanted = [bench.calibration.frame(OneServo(motion.servo_id, each)).servos[0][1] for each in ends]
    angles = [op.angle_cdeg for op in own]
    others = {(servo_id, op.angle_cdeg) for servo_id, op in ops if servo_id != motion.servo_id}
    return (
        sorted(servo_id for servo_id, op in ops if op.op is not Op.SET) == motion.started_ids
        and len(others) == len(motion.started_ids) - 1
        and [own[0], own[-1]] == wanted
        and angles in (sorted(angles), sorted(angles, reverse=True))
    )


def silence(bench: Bench) -> Figures:
    """Start the servo, then fall silent: the watchdog stops it in time."""
    before = bench.client.state().watchdog
    bench.start()
    begun_s = time.monotonic()
    stopped = bench.wait_until_stopped()
    took_ms, slack_ms = ms_since(begun_s) - bench.answer_ms, bench.options.late_ms + bench.answer_ms
    demand(stopped, f"it still runs, {took_ms:.0f} ms after its last command")
    expired = bench.client.state().watchdog.expirations > before.expirations
    demand(expired, "it stopped, but not by the watchdog")
    if bench.frames_published:
        bench.wait(lambda: bench.caused(Cause.WATCHDOG, stops=True), EVIDENCE_S)
        started, ended = bench.caused(Cause.COMMAND, stops=False), bench.caused(Cause.WATCHDOG, stops=True)
        demand(started and ended, "no Stop of the watchdog was written for the leg")
        # From the start's first frame: a start soon after a Stop goes on to its angle by further frames.
        took_ms, slack_ms = (ended[0].monotonic_ns - started[0].monotonic_ns) / 1e6, bench.options.late_ms
        bench.demand_no_motion("after the watchdog's Stop")
    late_ms, silent = took_ms - before.stops_after_ms, f"{before.timeout_ms:g} ms of silence"
    silent += f" and {before.landing_ms:g} ms of landing" if before.landing_ms else ""
    demand(abs(late_ms) <= slack_ms, f"the Stop came {took_ms:.1f} ms after the last command, not after {silent}")
    return {"timeout_ms": before.timeout_ms, "landing_ms": before.landing_ms, "later_us": late_ms * 1000}


def estop(bench: Bench) -> Figures:
    """Engage the emergency stop while setpoints stream: six Stops, no motion after them, and a reset."""
    with bench.streaming():
        demand(bench.running(), "the leg does not run in a stream of setpoints")
        begun_s = time.monotonic()
        ack = bench.client.estop()
        took_ms = ms_since(begun_s)
        time.sleep(STREAM_S)
    bench.estop, latency_us, limit_ms = ack.estop or 0, ack.latency_us or 0.0, _ANSWER_MS + bench.answer_ms
    running, mode = bench.running(), bench.client.state().mode
    demand(not running, f"servos run after the emergency stop: {[*running]}")
    demand(mode == Mode.ESTOPPED, f"the mode is {mode} after the emergency stop")
    demand(ack.stop_frames == len(LEGS), f"{ack.stop_frames} Stops were written, not {len(LEGS)}")
    late = f"the sixth Stop came {latency_us / 1000:.1f} ms after the request"
    demand(latency_us <= bench.options.late_ms * 1000, late)
    demand(took_ms <= limit_ms, f"the answer took {took_ms:.1f} ms, where any other takes {bench.answer_ms:.1f} ms")
    if bench.frames_published:
        after = list(dropwhile(lambda each: each[0].cause != Cause.ESTOP, bench.frames))
        legs = {frame.leg for record, frame in after if record.cause == Cause.ESTOP and frame.is_stop}
        demand(legs == set(LEGS), f"Stops were written for the legs {sorted(legs)} only")
        moves = [frame for _, frame in after if not frame.is_stop]
        demand(not moves, f"{len(moves)} frames moved a servo after the emergency stop")
    bench.start(Reason.ESTOPPED)
    bench.reset()
    return {"request_to_sixth_stop_us": latency_us, "request_to_answer_ms": took_ms, "stop_frames": len(LEGS)}


def stop_servos(bench: Bench) -> Figures:
    """Run `stop-servos` while the gateway runs: the gateway notices, and nothing moves."""
    state, config = bench.client.state(), bench.options.config
    if state.simulated or not Path(state.spi.device).exists():
        raise Skipped(f"{'a simulated controller' if state.simulated else state.spi.device} is not on this machine")
    with bench.streaming():
        begun_s = time.monotonic()
        _run(sys.executable, "-m", "gateway", "stop-servos", *(() if config is None else ("--config", str(config))))
        took_ms = ms_since(begun_s)
        demand(bench.wait_for_event(Kind.STOPPED_OUTSIDE, EVIDENCE_S), "the gateway did not notice it")
        own = any(record.cause == Cause.REPEAT for record, _ in bench.frames)
        demand(own or not bench.frames_published, "the gateway wrote no Stops of its own")
        bench.demand_no_motion("after stop-servos")
    return {"took_ms": took_ms}


def restart(bench: Bench) -> Figures:
    """Kill the service while setpoints stream: systemd stops the servos and starts the service again."""
    if not bench.options.restart:
        raise Skipped("only with --restart, on the robot itself")
    before = shown(SERVICE)
    begun_s = int(before.get("ExecMainStartTimestampMonotonic") or 0) / 1e6
    if before.get("LoadState") != "loaded":
        raise Skipped(f"this machine has no {SERVICE}.service; run it on the robot")
    if abs(time.monotonic() - bench.client.state().uptime_s - begun_s) > _SAME_START_S:
        raise Skipped(f"{SERVICE}.service of this machine is not the gateway that answers; run it on the robot")
    demand("stop-servos" in before.get("ExecStopPost", ""), "no stop-servos runs after its end, so it is not killed")

    def how_stop_servos_ended() -> str:
        """Return how `stop-servos` ended, which systemd shows until the new start."""
        now = shown(SERVICE)
        found = re.search(r"stop-servos[^}]* (code=\w+ ; status=\d+)", now.get("ExecStopPost", ""))
        started = now.get("InvocationID") != before.get("InvocationID")
        return found[1] if found else "it did not run" * started

    def back() -> bool:
        with suppress(GatewayError):
            state = bench.client.state(1.0)
            return state.uptime_s < time.monotonic() - begun_s and state.mode == Mode.IDLE
        return False

    with bench.streaming():
        begun_s = time.monotonic()
        _run("systemctl", "kill", "--signal=KILL", f"{SERVICE}.service")
        ended = bench.wait(how_stop_servos_ended, _PROGRAM_S)
        answers, took_s = bench.wait(back, _PROGRAM_S), time.monotonic() - begun_s
        demand(answers, f"no new gateway has answered for {_PROGRAM_S:g} s; stop the robot by the switch of its supply")
        frames = bench.client.state().spi.frames
        demand(frames >= len(LEGS), f"the new gateway wrote {frames} frames, not a Stop for each leg")
        bench.demand_no_motion("after the new start")
        demand(ended == "code=exited ; status=0", f"stop-servos did not stop the servos after the end: {ended}")
    return {"answers_again_after_s": took_s}


def _run(*words: str) -> None:
    try:
        done = subprocess.run(words, capture_output=True, text=True, timeout=_PROGRAM_S, check=False)
    except (OSError, subprocess.TimeoutExpired) as error:
        raise FailedError(f"{' '.join(words)}: {error}") from error
    demand(done.returncode == 0, f"{' '.join(words)} ended with {done.returncode}: {done.stderr.strip()}")


# ---- a power board: what it confirms, and one of its two ways unplugged


def power(bench: Bench) -> Figures:
    """Engage the emergency stop: the board confirms that no servo has power, and a reset powers none."""
    board(bench)
    with bench.streaming(0.0):
        figures = _cut(bench, own=True)
        bench.start(Reason.ESTOPPED)
        demand(not _power(bench).supplied, "the emergency stop is engaged, and the board feeds servos")
    _give_back(bench)
    return figures


def spi_unplugged(bench: Bench) -> Figures:
    """Unplug the controller while a servo runs: the emergency stop still cuts its power."""
    by_hand(bench)
    with bench.streaming():
        ask("Unplug the servo controller from the Pi (SPI), and press Enter. The servo goes on holding: ")
        figures = _cut(bench, own=False)
    loose = ask("Turn the servo's horn gently with a finger: is it loose? yes or no: ")
    # The controller has not received its Stop: with power the servo would run again.
    ask("Plug the controller in again, and press Enter: ")
    again = bench.client.estop()  # six Stops, which arrive now
    demand(again.stop_frames == len(LEGS), f"{again.stop_frames} Stops were written, not {len(LEGS)}")
    bench.estop = again.estop or 0
    demand(loose == "yes", "the board has confirmed that it feeds no servo, and one is not loose")
    _give_back(bench)
    return figures


def can_unplugged(bench: Bench) -> Figures:
    """Unplug the board while a servo runs: this is reported, and the robot is stopped over SPI."""
    by_hand(bench)
    with bench.streaming():
        hint("Unplug the power board's CAN now, and leave its supply on …")
        seen = bench.wait_for_event(Kind.POWER_UNCONFIRMED, _PLUGGED_S)
        silent_ms = _power(bench).age_ms or 0.0
        demand(seen, f"no event power_unconfirmed has come within {_PLUGGED_S:g} s")
        demand(bench.wait_until_stopped(), "it still runs, and the board does not answer")
        bench.start(Reason.NO_POWER)
        bench.demand_no_motion("while the board does not answer")
        ask("Plug it in again, and press Enter: ")
        demand(bench.wait(lambda: _power(bench).alive, EVIDENCE_S), "the board does not answer; is it in standby?")
        bench.demand_no_motion("once the board answers again")
    in_time = silent_ms - _SILENT_MS <= bench.options.late_ms + bench.answer_ms
    demand(in_time, f"it was reported {silent_ms:.0f} ms after the last answer")
    return {"silent_when_reported_ms": silent_ms}


def _power(bench: Bench) -> PowerReport:
    found = bench.client.state().power
    if found is None:
        raise Skipped("this robot has no power board")
    return found


def board(bench: Bench) -> None:
    """Raise Skipped without a power board, FailedError if it does not answer."""
    demand(_power(bench).alive, "the power board does not answer")


def by_hand(bench: Bench) -> None:
    """Raise Skipped unless --unplug was given, a person is there, and a real board can be unplugged."""
    if not bench.options.unplug or not sys.stdin.isatty():
        raise Skipped("only with --unplug, and a person at the robot")
    board(bench)
    if bench.client.state().simulated:
        raise Skipped("a simulated controller has no plug")


def _cut(bench: Bench, *, own: bool) -> Figures:
    """Engage an emergency stop that the board confirms. `own`: the step's end resets it in any case."""
    ack = bench.client.estop()
    bench.estop = (ack.estop or 0) if own else 0
    demand(ack.confirmed, "the board has not confirmed that the servos have no supply: SWITCH IT OFF BY HAND")
    demand(not (fed := _power(bench).supplied), f"the board has confirmed that it feeds nothing, and feeds {fed}")
    return {"confirmed_after_ms": ack.confirmed_ms or 0.0}


def _give_back(bench: Bench) -> None:
    """End the emergency stop: no servo has power, and none runs."""
    bench.reset()
    demand(bench.wait(lambda: is_at_rest(bench.client), _REST_S), "servos are fed after the reset; none was started")


def is_at_rest(client: Client) -> bool:
    """Return whether no servo runs, and the board answers and powers none."""
    state = client.state()
    return state.mode is Mode.IDLE and state.power is not None and state.power.alive and not state.power.supplied


STEPS: Final = tuple(
    map(CheckStep.of, (command, silence, estop, stop_servos, restart, power, spi_unplugged, can_unplugged))
)
"""The steps in their order. After each, all legs are stopped."""
