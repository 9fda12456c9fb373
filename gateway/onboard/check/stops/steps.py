"""The steps of `check --stops`. Each returns its figures, or raises FailedError or Skipped."""

import re
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Final, NamedTuple

from gateway.errors import GatewayError
from gateway.model.frames import Op
from gateway.onboard.check.stops.bench import SETPOINT_PERIOD_S, STREAM_S, Bench, FailedError, Figures, Skipped, demand
from gateway.onboard.check.table import SERVICE, shown
from gateway.people.client.blocking import Client
from gateway.people.terminal import ask, hint
from schemas.robot import LEGS
from schemas.telemetry import Cause, GatewayState, Kind, Mode, PowerReport, Reason

EVIDENCE_S: Final = 5.0
ANSWER_MS: Final = 100.0
"""How long the answer to an emergency stop may take, beyond that of any other question."""
TRAVEL_S: Final = 20.0
"""For 15° at 1° a second."""
PROGRAM_S: Final = 20.0
"""For stop-servos, systemctl, and a new start of the service."""
_SAME_START_S: Final = 15.0
"""From the begin of the service's process to that of its uptime: loading Python, on a slow board."""
REST_S: Final = 3.0
"""The board's errors are deleted behind a reset, for 2 s at most."""
SILENT_MS: Final = 200.0
"""A power board that is silent for so long is reported."""
PLUGGED_S: Final = 60.0
"""How long a person may take to plug or unplug something."""


class CheckStep(NamedTuple):
    """One step: what a person reads before it, and what does it."""

    name: str
    does: str
    run: Callable[[Bench], Figures]


def command(bench: Bench) -> Figures:
    """Start, set and stop; their frames are written, none that goes back, and no others."""
    mark, motion, begun_s = len(bench.frames), bench.motion, time.monotonic()
    bench.start()
    start_ms, end_s = (time.monotonic() - begun_s) * 1000, time.monotonic() + TRAVEL_S
    arrived = False
    while not arrived:  # several steps where max_speed_deg_s limits it
        bench.ask("set", motion.end_deg)
        state = bench.client.state()
        running = bench.running(state)
        demand(running == motion.started_ids, f"these servos were started: {motion.started_ids}; these run: {running}")
        (servo,) = (each for leg in state.legs for each in leg.servos if each.id == motion.servo_id)
        arrived = servo.angle_deg == motion.end_deg
        on_the_way = servo.target_deg == motion.end_deg and time.monotonic() < end_s
        demand(arrived or on_the_way, f"set to {motion.end_deg:g}°, and the state has {servo.angle_deg}")
        time.sleep(0 if arrived else SETPOINT_PERIOD_S)
    bench.demand(bench.client.stop(), "a Stop")
    wanted = [bench.frame(Op.START, motion.start_deg), bench.frame(Op.SET, motion.end_deg)]
    if bench.frames_published:
        stopped = bench.wait(lambda: bench.caused(Cause.COMMAND, mark, moves=False), EVIDENCE_S)
        found = [each.frame for each in bench.frames[mark:] if each.moves]
        found = [each for each in found if each.leg == motion.leg or not motion.holding]  # the others hold
        shown = ", ".join(each.to_bytes().hex() for each in found) or "none"
        first, last = (each.to_bytes().hex() for each in wanted)
        ends = [found[0], found[-1]] == wanted if found else False
        angles = [sorted((servo, each.angle_cdeg) for servo, each in frame.servos) for frame in found]
        one_way = angles in (sorted(angles), sorted(angles, reverse=True))
        sets = all(each.op is Op.SET for frame in found[1:] for _, each in frame.servos)
        demand(ends and one_way and sets, f"these frames moved it: {shown}; wanted: {first}, {last}")
        demand(stopped, "no Stop was written")
    bench.demand_no_motion("after the Stop")
    return {"start_to_answer_ms": start_ms, "frame": wanted[0].to_bytes().hex()}


def silence(bench: Bench) -> Figures:
    """Start, and send nothing more."""
    watchdog, mark = bench.client.state().watchdog, len(bench.frames)
    silent, figures = f"{watchdog.timeout_ms:g} ms of silence", Figures(timeout_ms=watchdog.timeout_ms)
    if watchdog.landing_ms:
        silent += f" and {watchdog.landing_ms:g} ms of landing"
        figures["landing_ms"] = watchdog.landing_ms
    bench.start()
    begun_s = time.monotonic()
    stopped = bench.wait(lambda: not bench.running(), watchdog.stops_after_ms / 1000 + 1)
    took_ms = (time.monotonic() - begun_s) * 1000
    demand(stopped, f"it still runs, {took_ms:.0f} ms after its last command; it was to stop after {silent}")
    now = bench.client.state().watchdog
    demand(now.expirations > watchdog.expirations, "it stopped, but not by the watchdog")
    if not bench.frames_published:
        late_ms = took_ms - watchdog.stops_after_ms - bench.answer_ms
        demand(late_ms <= bench.options.late_ms + bench.answer_ms, f"it ran on for {late_ms:.0f} ms after {silent}")
        return {**figures, "stopped_after_ms_by_state": took_ms}
    written = bench.wait(lambda: bench.caused(Cause.WATCHDOG, mark, moves=False), EVIDENCE_S)
    started = bench.caused(Cause.COMMAND, mark, moves=True)
    demand(written and started, "no Stop of the watchdog was written for the leg")
    stop = bench.caused(Cause.WATCHDOG, mark, moves=False)[0]
    late_us = (stop.at_ns - started[-1].at_ns) / 1000 - watchdog.stops_after_ms * 1000
    demand(late_us <= bench.options.late_ms * 1000, f"the Stop came {late_us / 1000:.1f} ms after {silent}")
    demand(
        late_us >= -bench.options.late_ms * 1000, f"the Stop came {-late_us / 1000:.1f} ms before the end of {silent}"
    )
    bench.demand_no_motion("after the watchdog's Stop")
    return {**figures, "later_us": late_us, "repeats": len(bench.caused(Cause.REPEAT, mark, moves=False))}


def estop(bench: Bench) -> Figures:
    """An emergency stop while setpoints go on streaming, and its reset."""
    with bench.streaming():
        demand(bench.running(), "the leg does not run in a stream of setpoints")
        mark, begun_s = len(bench.frames), time.monotonic()
        ack = bench.client.estop()
        took_ms = (time.monotonic() - begun_s) * 1000
        time.sleep(STREAM_S)
    bench.estop, latency_us = ack.estop or 0, ack.latency_us or 0.0
    state = bench.client.state()
    demand(not bench.running(state), f"servos run after the emergency stop: {bench.running(state)}")
    demand(state.mode == Mode.ESTOPPED, f"the mode is {state.mode} after the emergency stop")
    demand(ack.stop_frames == len(LEGS), f"{ack.stop_frames} Stops were written, not {len(LEGS)}")
    demand(
        latency_us <= bench.options.late_ms * 1000, f"the sixth Stop came {latency_us / 1000:.1f} ms after the request"
    )
    limit_ms = ANSWER_MS + bench.answer_ms
    demand(took_ms <= limit_ms, f"the answer took {took_ms:.1f} ms, where any other takes {bench.answer_ms:.1f} ms")
    if bench.frames_published:
        frames = bench.frames[mark:]
        stops = [place for place, each in enumerate(frames) if each.cause == Cause.ESTOP and not each.moves]
        legs = {frames[place].frame.leg for place in stops}
        demand(legs == set(LEGS), f"Stops were written for the legs {sorted(legs)} only")
        after = [each for each in frames[stops[0] :] if each.moves]
        demand(not after, f"{len(after)} frames moved a servo after the emergency stop")
    bench.start(Reason.ESTOPPED)
    mark = len(bench.frames)  # a setpoint may have been written between the first mark and the emergency stop
    bench.reset()
    bench.demand_no_motion("after the reset", mark)
    return {"request_to_sixth_stop_us": latency_us, "request_to_answer_ms": took_ms, "stop_frames": len(LEGS)}


def stop_servos(bench: Bench) -> Figures:
    """`stop-servos`, while the gateway runs."""
    state = bench.client.state()
    if state.simulated or not Path(state.spi.device).exists():
        raise Skipped(f"{'a simulated controller' if state.simulated else state.spi.device} is not on this machine")
    with bench.streaming():
        mark, events, begun_s = len(bench.frames), len(bench.events), time.monotonic()
        config = bench.options.config
        _run(sys.executable, "-m", "gateway", "stop-servos", *(() if config is None else ("--config", str(config))))
        took_ms = (time.monotonic() - begun_s) * 1000
        demand(bench.wait_for_event(Kind.STOPPED_OUTSIDE, events, EVIDENCE_S), "the gateway did not notice it")
        own = [each for each in bench.frames[mark:] if each.cause == Cause.REPEAT]
        demand(own or not bench.frames_published, "the gateway wrote no Stops of its own")
        bench.demand_no_motion("after stop-servos")
    return {"took_ms": took_ms}


# ---- the service is killed, on the robot itself


def killed(bench: Bench) -> Figures:
    """The service dies in a stream of setpoints; systemd stops the servos and starts it again."""
    if not bench.options.restart:
        raise Skipped("only with --restart, on the robot itself")
    before = seen = shown(SERVICE)
    begun_s = int(before.get("ExecMainStartTimestampMonotonic") or 0) / 1e6
    if before.get("LoadState") != "loaded":
        raise Skipped(f"this machine has no {SERVICE}.service; run it on the robot")
    if abs(time.monotonic() - bench.client.state().uptime_s - begun_s) > _SAME_START_S:
        raise Skipped(f"{SERVICE}.service of this machine is not the gateway that answers; run it on the robot")
    demand("stop-servos" in before.get("ExecStopPost", ""), "no stop-servos runs after its end, so it is not killed")
    ended = ""

    def over() -> bool:
        """Whether stop-servos has ended, or the new start has come, at which systemd forgets how."""
        nonlocal seen, ended
        seen = shown(SERVICE)
        found = re.search(r"stop-servos[^}]* code=(\w+) ; status=(\d+)", seen.get("ExecStopPost", ""))
        ended = " ".join(found.groups()) if found else ""
        return bool(ended) or seen.get("InvocationID") != before.get("InvocationID")

    def back() -> bool:
        with suppress(GatewayError):
            state = bench.client.state(1.0)
            return state.uptime_s < time.monotonic() - begun_s and state.mode == Mode.IDLE
        return False

    with bench.streaming():
        begun_s = time.monotonic()
        _run("systemctl", "kill", "--signal=KILL", f"{SERVICE}.service")
        bench.wait(over, PROGRAM_S)
        answers = bench.wait(back, PROGRAM_S)
        took_s = time.monotonic() - begun_s
        demand(answers, f"no new gateway has answered for {PROGRAM_S:g} s; stop the robot by the switch of its supply")
        frames = bench.client.state().spi.frames
        demand(frames >= len(LEGS), f"the new gateway wrote {frames} frames, not a Stop for each leg")
        bench.demand_no_motion("after the new start")
        demand(ended == "exited 0", f"stop-servos did not stop the servos after the end: {ended or 'it did not run'}")
    figures: Figures = {"answers_again_after_s": took_s, "stops_of_the_new_start": len(LEGS)}
    with suppress(FailedError):  # there is no journal
        journal = _run("journalctl", f"_SYSTEMD_INVOCATION_ID={before.get('InvocationID')}", "--output=cat")
        figures |= said_by_stop_servos(journal)
    return figures


def said_by_stop_servos(text: str) -> Figures:
    """What it reports: its Stops, and when the power board confirmed."""
    written = re.search(r"Stop written to all six legs, (\d+) times each", text)
    confirmed = re.search(r"the power board has confirmed: .* after (\d+) ms", text)
    figures: Figures = {} if written is None else {"stops_of_stop_servos": len(LEGS) * int(written[1])}
    return figures if confirmed is None else {**figures, "supply_off_confirmed_after_ms": int(confirmed[1])}


def _run(*command: str) -> str:
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=PROGRAM_S, check=False)
    except (OSError, subprocess.TimeoutExpired) as error:
        raise FailedError(f"{' '.join(command)}: {error}") from error
    demand(done.returncode == 0, f"{' '.join(command)} ended with {done.returncode}: {done.stderr.strip()}")
    return done.stdout


# ---- a power board: what it confirms, and one of its two ways unplugged


def confirmed_off(bench: Bench) -> Figures:
    """An emergency stop: the board confirms that no servo is fed, and a reset feeds none."""
    board(bench)
    with bench.streaming(0.0):
        figures = _cut(bench, own=True)
        bench.start(Reason.ESTOPPED)
        demand(not _fed(bench), f"while the emergency stop is engaged, the board feeds {_fed(bench)}")
    _give_back(bench)
    return figures


def spi_unplugged(bench: Bench) -> Figures:
    """The controller cannot be reached while a servo runs: the emergency stop takes its supply all the same."""
    by_hand(bench)
    with bench.streaming():
        person("Unplug the servo controller from the Pi (SPI), and press Enter. The servo goes on holding: ")
        figures = _cut(bench, own=False)
    loose = person("Turn the servo's horn gently with a finger: is it loose? yes or no: ")
    # The controller has not received its Stop: fed again, the servo would run.
    person("Plug the controller in again, and press Enter: ")
    again = bench.client.estop()  # six Stops, which arrive now
    demand(again.stop_frames == len(LEGS), f"{again.stop_frames} Stops were written, not {len(LEGS)}")
    bench.estop = again.estop or 0
    demand(loose == "yes", "the board has confirmed that it feeds no servo, and one is not loose")
    _give_back(bench)
    return figures


def can_unplugged(bench: Bench) -> Figures:
    """The board cannot be reached while a servo runs: that is reported, and the robot stopped over SPI."""
    by_hand(bench)
    with bench.streaming():
        events = len(bench.events)
        hint("Unplug the power board's CAN now, and leave its supply on …")
        seen = bench.wait_for_event(Kind.POWER_UNCONFIRMED, events, PLUGGED_S)
        state = bench.client.state()
        silent_ms = _power(state).age_ms or 0.0
        demand(seen, f"no event power_unconfirmed has come within {PLUGGED_S:g} s")
        stopped = bench.wait(lambda: not bench.running(), state.watchdog.stops_after_ms / 1000 + 1)
        demand(stopped, "it still runs, and the board does not answer")
        bench.start(Reason.NO_POWER)
        bench.demand_no_motion("while the board does not answer")
        person("Plug it in again, and press Enter: ")
        back = bench.wait(lambda: _power(bench.client.state()).alive, EVIDENCE_S)
        demand(back, "the board does not answer; is it in standby?")
        bench.demand_no_motion("once the board answers again")
    late_ms = silent_ms - SILENT_MS
    demand(
        late_ms <= bench.options.late_ms + bench.answer_ms, f"it was reported {silent_ms:.0f} ms after the last answer"
    )
    return {"silent_when_reported_ms": silent_ms}


def _power(state: GatewayState) -> PowerReport:
    if state.power is None:
        raise FailedError("the gateway has no power board any more")
    return state.power


def board(bench: Bench) -> None:
    """Raises Skipped where no servo's supply can be taken."""
    power = bench.client.state().power
    if power is None:
        raise Skipped("this robot has no power board")
    demand(power.alive, "the power board does not answer")


def by_hand(bench: Bench) -> None:
    """Raises Skipped where nobody has agreed to unplug anything, or nothing can be unplugged."""
    if not bench.options.unplug or not sys.stdin.isatty():
        raise Skipped("only with --unplug, and a person at the robot")
    board(bench)
    if bench.client.state().simulated:
        raise Skipped("a simulated controller has no plug")


def person(question: str) -> str:
    """What a person answers."""
    return ask(question)


def _fed(bench: Bench) -> tuple[int, ...]:
    return _power(bench.client.state()).supplied


def _cut(bench: Bench, *, own: bool) -> Figures:
    """An emergency stop that the board confirms. `own`: to be left at the step's end, whatever happens."""
    ack = bench.client.estop()
    bench.estop = (ack.estop or 0) if own else 0
    demand(ack.confirmed, "the board has not confirmed that the servos have no supply: SWITCH IT OFF BY HAND")
    demand(not _fed(bench), f"the board has confirmed that it feeds nothing, and feeds {_fed(bench)}")
    return {"confirmed_after_ms": ack.confirmed_ms or 0.0}


def _give_back(bench: Bench) -> None:
    """Leave the emergency stop: nothing is fed then, and nothing runs."""
    mark = len(bench.frames)
    bench.reset()
    demand(bench.wait(lambda: is_at_rest(bench.client), REST_S), "servos are fed after the reset, and none was started")
    bench.demand_no_motion("after the reset", mark)


def is_at_rest(client: Client) -> bool:
    """Whether nothing runs, and the board answers and feeds nothing."""
    state = client.state()
    return state.mode is Mode.IDLE and _power(state).alive and not _power(state).supplied


# fmt: off
STEPS: Final = (
    CheckStep("command", "starts {servos} at {start:g}°, sets {end:g}°, and stops again", command),
    CheckStep("silence", "starts {servos} and falls silent: the watchdog must {end_of_silence}", silence),
    CheckStep("estop", "engages the emergency stop while setpoints stream: six Stops, nothing after, a reset", estop),
    CheckStep("stop-servos", "runs stop-servos while the gateway runs and setpoints stream", stop_servos),
    CheckStep("restart", "kills the service while setpoints stream: stopped at once, and at its new start", killed),
    CheckStep("power", "engages the emergency stop: the power board must confirm that no servo is fed", confirmed_off),
    CheckStep("spi-unplugged", "engages the emergency stop while the controller is unplugged: the power board must "
              "confirm it", spi_unplugged),
    CheckStep("can-unplugged", "the power board is unplugged while {servos} runs: must be reported, and stopped over "
              "SPI", can_unplugged),
)
# fmt: on
"""In their order. Each leaves all legs stopped, or `check --stops` does."""
