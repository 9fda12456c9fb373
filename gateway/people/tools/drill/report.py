"""The report of a drill: JSON for programs, and one HTML file with plots for a folder of reports."""

import json
import os
from datetime import UTC, datetime
from html import escape
from pathlib import Path
from typing import Any, Final

from gateway.errors import ConfigError
from gateway.people.tools.drill.bench import WrittenFrame
from gateway.people.tools.drill.run import Drill, StepResult

MOST_FRAMES: Final = 5000
"""In the report of one step; a stream of 50 Hz for ten seconds has 500."""
_WIDTH: Final = 900
_LEFT: Final = 60
_ROW: Final = 18
_COLOURS: Final = {
    "command": "#4878a8",
    "watchdog": "#c07820",
    "estop": "#b03030",
    "repeat": "#a0a0a0",
    "startup": "#609060",
    "shutdown": "#609060",
}


def as_json(drill: Drill, now: datetime) -> dict[str, Any]:
    """All that was measured. Frames are milliseconds since the step's first, bytes in hex, and cause."""
    state = drill.state
    return {
        "report": "hexapod-gateway drill 1",
        "time": now.isoformat(),
        "passed": drill.passed,
        "complete": drill.complete,
        "gateway": {
            "version": state.version,
            "protocol": state.protocol,
            "simulated": state.simulated,
            "device": state.spi.device,
            "framing": state.spi.framing,
            "watchdog_timeout_ms": state.watchdog.timeout_ms,
            "watchdog_landing_ms": state.watchdog.landing_ms,
        },
        "claims_shown": _claims(drill),
        "leg": drill.leg,
        "frames_published": drill.frames_published,
        "steps": [
            {
                "name": outcome.name,
                "does": outcome.does,
                "result": outcome.word.lower(),
                "claim": outcome.shows,
                "detail": outcome.detail,
                "figures": outcome.figures,
                "took_s": round(outcome.took_s, 3),
                "frames": [
                    [round(at_ms, 3), seen.frame.to_bytes().hex(), seen.cause] for at_ms, seen in _timed(outcome.frames)
                ],
            }
            for outcome in drill.outcomes
        ],
    }


def _claims(drill: Drill) -> list[str]:
    """Of the safety case (docs/safety.md), those whose steps were done here and all passed."""
    failed = {outcome.shows for outcome in drill.outcomes if outcome.passed is False}
    passed = dict.fromkeys(outcome.shows for outcome in drill.outcomes if outcome.passed)
    return [claim for claim in passed if claim not in failed]


def check(path: Path) -> None:
    """Whether the report can be written there, before anything moves for it. Raises ConfigError."""
    there = path if path.exists() else path.parent
    if path.is_dir():
        why = "it is a folder"
    elif not there.exists():
        why = f"there is no folder {path.parent}"
    elif not os.access(there, os.W_OK):
        why = "this user may not write there"
    else:
        return
    raise ConfigError(f"{path}: the report cannot be written ({why}); nothing was moved")


def write(path: Path, drill: Drill) -> None:
    """Write the report, as HTML or, where the name ends in .json, as JSON. Raises ConfigError."""
    now = datetime.now(UTC).astimezone()
    found = as_json(drill, now)
    text = json.dumps(found, indent=1) + "\n" if path.suffix == ".json" else _html(drill, found, now)
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{path}: the report cannot be written ({error.strerror})") from error


def _timed(frames: list[WrittenFrame]) -> list[tuple[float, WrittenFrame]]:
    return [((seen.at_ns - frames[0].at_ns) / 1e6, seen) for seen in frames[:MOST_FRAMES]]


def _html(drill: Drill, found: dict[str, Any], now: datetime) -> str:
    gateway = found["gateway"]
    verdict = "passed" if drill.passed else "NOT passed" if drill.complete else "NOT finished"
    device = "a simulated controller" if gateway["simulated"] else f"{gateway['device']}, {gateway['framing']}"
    head = (
        f"{now:%Y-%m-%d %H:%M:%S %Z} · gateway {gateway['version']} · {device} · leg {drill.leg} · "
        f"watchdog {gateway['watchdog_timeout_ms']:g} ms"
    )
    if gateway["watchdog_landing_ms"]:
        head += f", then a landing of {gateway['watchdog_landing_ms']:g} ms"
    if drill.lost is not None:
        head += " · the gateway was lost, and nobody has confirmed that all legs are stopped"
    steps = "\n".join(map(_section, drill.outcomes))
    claims = ", ".join(found["claims_shown"]) or "none"
    where = "a simulated controller, and no robot, has" if gateway["simulated"] else "this robot has"
    return f"""<!doctype html>
<html lang="en"><meta charset="utf-8"><title>Drill: {verdict}</title>
<style>{_STYLE}</style>
<h1>Drill: {verdict}</h1><p>{escape(head)}</p>
{steps}
<section><h2>Claims of the safety case that {where} shown</h2><p>{escape(claims)}</p></section>
<details><summary>As JSON</summary><pre>{escape(json.dumps(found, indent=1))}</pre></details>
</html>
"""


def _section(outcome: StepResult) -> str:
    figures = "".join(
        f"<tr><td>{escape(name)}</td><td>{value:.3f}</td></tr>"
        if isinstance(value, float)
        else f"<tr><td>{escape(name)}</td><td>{escape(str(value))}</td></tr>"
        for name, value in outcome.figures.items()
    )
    result = f"<p>{escape(outcome.detail)}</p>" if outcome.passed is not True else f"<table>{figures}</table>"
    return (
        f'<section><h2><b class="{outcome.word.lower()}">{outcome.word}</b> {escape(outcome.name)}</h2>'
        f"<p>{escape(outcome.does)} ({outcome.took_s:.1f} s)</p>{result}{_plot(outcome.frames)}</section>"
    )


def _plot(frames: list[WrittenFrame]) -> str:
    """Each frame over time, a row for each leg: full for what moves, hollow for a Stop."""
    timed = _timed(frames)
    if not timed:
        return ""
    end_ms = max(timed[-1][0], 1.0)
    height = 7 * _ROW + 20
    marks = []
    for at_ms, seen in timed:
        x, y = _LEFT + (_WIDTH - _LEFT - 20) * at_ms / end_ms, seen.leg * _ROW
        colour = _COLOURS.get(seen.cause, "#000000")
        fill = colour if seen.moves else "none"
        title = f"{at_ms:.3f} ms: {seen.cause}, {seen.frame.to_bytes().hex()}"
        circle = f'<circle cx="{x:.1f}" cy="{y}" r="4" fill="{fill}" stroke="{colour}">'
        marks.append(f"{circle}<title>{escape(title)}</title></circle>")
    rows = "".join(f'<text x="4" y="{leg * _ROW + 4}">leg {leg}</text>' for leg in range(1, 7))
    causes = [cause for cause in _COLOURS if any(seen.cause == cause for _, seen in timed)]
    legend = " ".join(f'<tspan fill="{_COLOURS[cause]}">● {cause}</tspan>' for cause in causes)
    return (
        f'<svg viewBox="0 0 {_WIDTH} {height}" role="img" aria-label="frames over time">{rows}{"".join(marks)}'
        f'<text x="{_LEFT}" y="{height - 4}">0 to {end_ms:.0f} ms {legend} (hollow: Stop)</text></svg>'
    )


_STYLE: Final = """
body { font: 15px/1.5 system-ui, sans-serif; max-width: 60rem; margin: 2rem auto; padding: 0 1rem; color: #222; }
h2 { font-size: 1.1rem; margin-bottom: 0; } section { border-top: 1px solid #ccc; padding: .5rem 0; }
.pass { color: #1a6a2a; } .fail { color: #b00020; } .skipped { color: #666; }
td { padding-right: 2rem; } svg { width: 100%; font-size: 11px; } pre { font-size: 11px; overflow: auto; }
@media print { details { display: none; } }
"""
