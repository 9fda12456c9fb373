"""The step that kills the service, on the robot itself: what systemd then does."""

import re
import subprocess
import time
from contextlib import suppress
from typing import Final, NamedTuple

from gateway.errors import GatewayError
from gateway.onboard.check.stops.bench import STREAM_S, Bench, FailedError, Figures, Skipped, demand
from schemas.robot import LEGS
from schemas.telemetry import GatewayState, Mode

SYSTEMCTL_S: Final = 20.0
BACK_S: Final = 20.0
_UNIT: Final = "hexapod-gateway.service"
_ENDED: Final = re.compile(r"stop-servos.* code=(\w+) ; status=(\d+)")
_WRITTEN: Final = re.compile(r"Stop written to all six legs, (\d+) times each")
_CONFIRMED: Final = re.compile(r"the power board has confirmed: .* after (\d+) ms")


_SAME_START_S: Final = 15.0
"""From the begin of the service's process to that of its uptime: loading Python, on a slow board."""


class _Unit(NamedTuple):
    """What systemd reports of the service."""

    loaded: bool
    begun_s: float
    """When its process began, monotonic."""

    invocation: str
    """Another one after each start."""
    has_stop_servos: bool
    stop_servos: str
    """How it ended, "" where it has not; systemd forgets it at the next start."""


def killed(bench: Bench) -> Figures:
    """The service dies in a stream of setpoints; systemd stops the servos and starts it again."""
    if not bench.restart:
        raise Skipped("only with --restart, on the robot itself")
    before = _unit_of(bench.client.state())
    demand(before.has_stop_servos, f"{_UNIT} runs no stop-servos after its end, so it is not killed")
    seen = before

    def over() -> bool:
        """Whether stop-servos has ended, or the new start has come."""
        nonlocal seen
        seen = _unit()
        return bool(seen.stop_servos) or seen.invocation != before.invocation

    bench.start()
    with bench.streaming():
        time.sleep(STREAM_S)
        begun_s = time.monotonic()
        _run("systemctl", "kill", "--signal=KILL", _UNIT)
        bench.wait(over, BACK_S)
        back = bench.wait(lambda: _started_since(bench, begun_s), BACK_S)
        took_s = time.monotonic() - begun_s
        demand(back, f"no new gateway has answered for {BACK_S:g} s; stop the robot by the switch of its supply")
        frames, ended = bench.client.state().spi.frames, seen.stop_servos
        demand(frames >= len(LEGS), f"the new gateway wrote {frames} frames, not a Stop for each leg")
        bench.demand_no_motion(bench.mark(), "after the new start")
        demand(ended == "exited 0", f"stop-servos did not stop the servos after the end: {ended or 'it did not run'}")
    figures: Figures = {"answers_again_after_s": took_s, "stops_of_the_new_start": len(LEGS)}
    with suppress(FailedError):  # there is no journal
        journal = _run("journalctl", f"_SYSTEMD_INVOCATION_ID={before.invocation}", "--output=cat")
        figures |= said_by_stop_servos(journal)
    return figures


def _unit_of(state: GatewayState) -> _Unit:
    """The service of the gateway that is checked. Raises Skipped where it is not of this machine."""
    try:
        unit = _unit()
    except FailedError as failed:
        raise Skipped(f"systemd on this machine reports no service ({failed}); run it on the robot") from failed
    if not unit.loaded:
        raise Skipped(f"this machine has no {_UNIT}; run it on the robot")
    if abs(time.monotonic() - state.uptime_s - unit.begun_s) > _SAME_START_S:
        raise Skipped(f"{_UNIT} of this machine is not the gateway that answers; run it on the robot")
    return unit


def _unit() -> _Unit:
    properties = "LoadState,ExecMainStartTimestampMonotonic,InvocationID,ExecStopPost"
    shown = _run("systemctl", "show", f"--property={properties}", _UNIT)
    found = dict(line.partition("=")[::2] for line in shown.splitlines())
    ended = _ENDED.search(shown)
    return _Unit(
        loaded=found.get("LoadState") == "loaded",
        begun_s=int(found.get("ExecMainStartTimestampMonotonic", 0)) / 1e6,
        invocation=found.get("InvocationID", ""),
        has_stop_servos="stop-servos" in shown,
        stop_servos="" if ended is None else " ".join(ended.groups()),
    )


def said_by_stop_servos(text: str) -> Figures:
    """What it reports: its Stops, and when the power board confirmed."""
    written, confirmed = _WRITTEN.search(text), _CONFIRMED.search(text)
    figures: Figures = {} if written is None else {"stops_of_stop_servos": len(LEGS) * int(written[1])}
    return figures if confirmed is None else {**figures, "supply_off_confirmed_after_ms": int(confirmed[1])}


def _started_since(bench: Bench, begun_s: float) -> bool:
    with suppress(GatewayError):
        state = bench.client.state(1.0)
        return state.uptime_s < time.monotonic() - begun_s and state.mode == Mode.IDLE
    return False


def _run(*command: str) -> str:
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=SYSTEMCTL_S, check=False)
    except (OSError, subprocess.TimeoutExpired) as error:
        raise FailedError(f"{command[0]}: {error}") from error
    demand(done.returncode == 0, f"{command[0]} {command[1]}: {done.stderr.strip()}")
    return done.stdout
