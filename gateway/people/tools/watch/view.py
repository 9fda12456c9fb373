"""Draws the model: one text of exactly the terminal's size. 80 columns and 24 rows hold everything important.

Nothing here waits, and colour is never the only sign: what runs has another mark than what rests.
"""

import datetime as dt
from typing import Final

from rich.cells import cell_len
from rich.text import Text

from gateway.certs import expiry
from gateway.model.telemetry import currents_a
from gateway.people.client.dangers import FULL_A, power_now, tone_of
from gateway.people.terminal.screen import ALARM, STYLES, fitted
from gateway.people.terminal.stop_status import Remark, Tone
from gateway.people.tools.watch.model import Counts, Model, WatchedPresence
from gateway.text import visible
from schemas.telemetry import ButtonsReport, GatewayState, LeaseReport, LegReport, Mode, ServoReport, WatchdogState

_MODES: Final[dict[str, str]] = {
    Mode.STARTING: "bold black on yellow",
    Mode.IDLE: "bold white on blue",
    Mode.ACTIVE: "bold black on green",
    Mode.ESTOPPED: "bold white on red",
    Mode.BUS_FAULT: "bold white on magenta",
    Mode.STOPPING: "bold black on yellow",
}
_KEYS: Final = Text.assemble(("  r: reset  q: quit  a: ask  t: take", "bold"), ("  (● on  ○ off)", "dim"))
_ASK: Final = "bold black on yellow"
_BANNER_ROWS: Final = 2
_MAX_TROUBLES: Final = 3
_TROUBLE_ROWS: Final = 4
_ROOMY_ROWS: Final = 24
_AGE_COLUMNS: Final = 22
_OLD_MS: Final = 1000.0
"""A measurement that is older says so: by default there are ten a second."""
_LEVELS: Final = "▁▂▃▄▅▆▇█"
_LEG_COLUMNS: Final = 4
_SOURCE_COLUMNS: Final = 14
_MAX_SOURCES: Final = 4
_EVENT_COLUMNS: Final = len("12:34:56 command_rejected ")


def picture(model: Model, now_ns: int, where: str, width: int, height: int) -> Text:
    """The whole screen, `height` lines of at most `width` columns."""
    live = model.presence(now_ns) is WatchedPresence.LIVE
    blank = [Text()] if height >= _ROOMY_ROWS else []
    stop = model.stop.remark(now_ns, live=live)
    top = [_header(model, now_ns, where), *_banner(model, stop, now_ns, width)]
    body = [] if model.state is None else [_head(model.state, width), *_legs(model, model.state, now_ns, width, live)]
    body += [] if model.state is None else _measured(model, model.state, now_ns, live)
    body += [] if model.state is None else _power(model, model.state, live)
    numbers = [] if model.state is None else [*blank, *_numbers(model.state, model.rates(), live)]
    trouble = [] if live else _trouble(model, width)
    room = max(0, height - len(top) - len(trouble) - len(body) - 1)
    rest = [*numbers, *_rejections(model), *blank, *_events(model, width, room)][:room]
    return fitted([*top, *trouble, *body, *rest], _KEYS, width, height, stop)


# ---- what matters most


def _header(model: Model, now_ns: int, where: str) -> Text:
    line = Text()
    state, presence = model.state, model.presence(now_ns)
    if presence is WatchedPresence.WAITING:
        line.append(" WAITING ", _ASK).append(f"  for a gateway on {where}")
        return line
    mode = "?" if state is None else visible(state.mode).upper().replace("_", " ")
    if presence is WatchedPresence.SILENT:
        line.append(f" SILENT for {model.silent_s(now_ns):.1f} s ", ALARM).append(f"  was {mode}")
    else:
        line.append(f" {mode} ", "bold" if state is None else _MODES.get(state.mode, "bold"))
    if state is not None and state.mode is Mode.ESTOPPED and state.estop_source is not None:
        line.append(f" by {_clipped(state.estop_source, _SOURCE_COLUMNS)}", "bold")
    if state is not None:
        running = model.running_legs()
        legs = f"{running} leg{'' if running == 1 else 's'} running"
        line.append(f"  {legs}", "bold green" if running and presence is WatchedPresence.LIVE else "dim")
        line.append_text(_driver(state.lease))
        line.append_text(_watchers(state.buttons))
        line.append(f"  {where}  up {dt.timedelta(seconds=int(state.uptime_s))}  {state.version}", "dim")
    return line


def _driver(lease: LeaseReport) -> Text:
    """The holder of the lease, and who asks for it."""
    if lease.holder is None:
        return Text()
    holder = _clipped(lease.holder, _SOURCE_COLUMNS) + ("" if lease.verified else "?")
    text = Text(f"  {holder} drives" if lease.held_s is not None else f"  handed to {holder}", "bold")
    if lease.asked_by is not None:
        text.append(f", {_clipped(lease.asked_by, _SOURCE_COLUMNS)} asks", "bold yellow")
    return text


def _watchers(buttons: ButtonsReport) -> Text:
    """How many stop buttons are alive, of how many that must be; nothing where nobody uses any."""
    if not (buttons.required or buttons.alive):
        return Text()
    enough = buttons.alive >= buttons.required
    return Text(f"  buttons {buttons.alive}/{buttons.required}", "bold green" if enough else "bold red")


def _banner(model: Model, stop: Remark | None, now_ns: int, width: int) -> list[Text]:
    """Two rows for the most urgent messages; a single message may fill both."""
    messages: list[tuple[str, str]] = []
    if stop is not None and stop.tone is Tone.BAD:
        messages.append((stop.text, ALARM))
    if (question := model.question(now_ns)) is not None:
        messages.append((question, _ASK))
    if model.presence(now_ns) is WatchedPresence.SILENT:
        messages.append(("The gateway is silent: below is the past. If the robot moves, cut power.", ALARM))
    if stop is not None and stop.tone is not Tone.BAD:
        messages.append((stop.text, STYLES[stop.tone]))
    if model.remark is not None:
        messages.append((model.remark.text, STYLES[model.remark.tone]))
    if model.state is not None and (fault := model.state.calibration.fault) is not None:
        messages.append((f"Nothing can be started (calibrate accept-default): {visible(fault)}", "bold yellow"))
    if (expiring := _expiring(model)) is not None:
        messages.append((f"{visible(expiring)}: see `certs renew`", "yellow"))
    if model.presence(now_ns) is WatchedPresence.WAITING:
        messages.append(("no connection; trying again" if model.trouble else "connecting …", "yellow"))
    rows = _BANNER_ROWS if len(messages) == 1 else 1
    lines = [Text(f" {row} ", style) for text, style in messages for row in _wrapped(text, width - 2, rows)]
    del lines[_BANNER_ROWS:]
    return lines + [Text()] * (_BANNER_ROWS - len(lines))


def _expiring(model: Model) -> str | None:
    """The certificate that expires soon, this laptop's or the robot's (by its own clock)."""
    certificate = None if model.state is None else model.state.certificate
    if model.own_expiry is not None or model.state is None or certificate is None:
        return model.own_expiry
    soon = expiry.soon(certificate.file, certificate.expires, model.state.time)
    return None if soon is None else f"the robot's {soon}"


def _trouble(model: Model, width: int) -> list[Text]:
    """Why there is no connection, a few rows for each host."""
    return [
        Text(f" {row} ", "yellow")
        for line in model.trouble.splitlines()[:_MAX_TROUBLES]
        for row in _wrapped(line, width - 2, _TROUBLE_ROWS)
    ]


def _wrapped(text: str, width: int, rows: int) -> list[str]:
    """At most so many rows; the last one holds the rest, however long."""
    lines = [""]
    for word in text.split():
        if lines[-1] and cell_len(f"{lines[-1]} {word}") > width and len(lines) < rows:
            lines.append("")
        lines[-1] += f" {word}" if lines[-1] else word
    return lines


# ---- legs


def _servo_columns(width: int) -> int:
    return max(10, (width - _LEG_COLUMNS - _AGE_COLUMNS - _SOURCE_COLUMNS) // 3)


def _head(state: GatewayState, width: int) -> Text:
    column = _servo_columns(width)
    line = Text("leg ", "dim")
    for joint in (1, 2, 3):
        line.append(f"joint {joint}".ljust(column))
    line.append(f"command / {state.watchdog.timeout_ms:g} ms".ljust(_AGE_COLUMNS))
    return line.append("commanded by")


def _legs(model: Model, state: GatewayState, now_ns: int, width: int, live: bool) -> list[Text]:
    column = _servo_columns(width)
    lines = []
    for leg in state.legs:
        line = Text().append(f" {leg.leg}  ", "bold")
        for servo in leg.servos:
            line.append_text(_servo(servo, column))
        age = _age(leg, model.command_age_ms(leg, now_ns), state.watchdog.timeout_ms, live)
        line.append_text(age)
        if leg.source is not None:
            line.append(" " * (_AGE_COLUMNS - age.cell_len)).append(_clipped(leg.source, _SOURCE_COLUMNS))
        if not live:
            line.stylize("dim")
        lines.append(line)
    return lines


def _measured(model: Model, state: GatewayState, now_ns: int, live: bool) -> list[Text]:
    """One row with what the robot measures, and whether its controller is alive; no row where neither is known."""
    found, battery, alive = model.telemetry, state.battery, state.controller.alive
    if found is not None and found.battery is not None:
        battery = found.battery
    line, quiet = Text(), "" if live else "dim"
    if battery is not None:
        line.append(f"  {battery.voltage_v:.2f} V  {battery.percent:.0f} %", quiet)
    if found is not None and found.tilt_deg is not None:
        line.append(f"  tilt {found.tilt_deg:.0f}°", quiet)
    if found is not None and found.temperature_c is not None:
        line.append(f"  {found.temperature_c:.1f} °C", quiet)
    if alive is not None:
        line.append("  controller alive" if alive else "  CONTROLLER SILENT", quiet if alive else "bold red")
    if found is not None and (age_ms := model.measured_age_ms(now_ns)) > _OLD_MS:
        line.append(f"  {ago_words(age_ms)} old", "yellow")
    if found is not None and found.feet is not None and model.carrying is not None:
        feet = zip(model.carrying, found.feet, strict=True)
        line.append("  feet " + " ".join(f"{'●' if carries else '○'}{force:.3g}" for carries, force in feet), quiet)
    return [line] if line else []


def _power(model: Model, state: GatewayState, live: bool) -> list[Text]:
    """One row with the power board, what it feeds, and a bar for each servo's current; no row without a board."""
    if state.power is None:
        return []
    bad = live and bool(model.stop.power.sentence)
    line = Text().append(f"  power {power_now(state.power)}", "bold red" if bad else "" if live else "dim")
    drawn = currents_a(model.telemetry)
    if drawn:
        most = max(drawn, key=drawn.__getitem__)
        full_a = max(FULL_A, drawn[most])
        legs = ("".join(_level(drawn.get(servo.id), full_a) for servo in leg.servos) for leg in state.legs)
        line.append(f"  {' '.join(legs)}", "cyan" if live else "dim")
        line.append(f"  most {most}: {drawn[most]:.2f} A", "" if live else "dim")
    supply = None if model.telemetry is None else model.telemetry.supply
    if supply is not None:
        line.append(f"  {supply.voltage_v:.1f} V {supply.current_a:.1f} A", "" if live else "dim")
    return [line]


def _level(current_a: float | None, full_a: float) -> str:
    """One character: a bar of so high a share of the full current."""
    return "·" if current_a is None else _LEVELS[min(round(current_a / full_a * len(_LEVELS)), len(_LEVELS) - 1)]


def _clipped(source: str, columns: int) -> str:
    text = visible(source)
    return text if len(text) <= columns else text[: columns - 1] + "…"


def _servo(servo: ServoReport, column: int) -> Text:
    angle = "  —  " if servo.angle_deg is None else f"{servo.angle_deg:6.2f}°"
    style = "green" if servo.running else "dim"
    cell = Text().append("● " if servo.running else "○ ", style).append(angle.rjust(7), style).append(" ")
    bar_columns = column - 11
    if bar_columns > 1:
        cell.append_text(bar((servo.angle_deg or 0) / 180, bar_columns, style))
    cell.append(" " * (column - cell.cell_len))
    return cell


def _age(leg: LegReport, age_ms: float | None, timeout_ms: float, live: bool) -> Text:
    if age_ms is None:
        return Text("never", "dim")
    if not live:
        return Text("?")
    if leg.watchdog is WatchdogState.ARMED:
        share = age_ms / timeout_ms
        style = "green" if share < 0.5 else "yellow" if share < 0.8 else "red"
        return bar(share, 10, style).append(f" {age_ms:5.0f} ms", style)
    ago = f"{ago_words(age_ms)} ago"
    if leg.watchdog is WatchdogState.EXPIRED:
        return Text(f"EXPIRED, {ago}", "bold red")
    return Text(ago, "dim")


def ago_words(age_ms: float) -> str:
    """An age for people, at most seven characters of it."""
    age_s = age_ms / 1000
    if age_s < 100:
        return f"{age_s:.1f} s"
    return f"{age_s / 60:.0f} min" if age_s < 6000 else f"{age_s / 3600:.0f} h"


def bar(share: float, columns: int, style: str) -> Text:
    """A bar of so many columns, filled by `share`, 0 to 1, to half a column."""
    halves = round(max(0.0, min(share, 1.0)) * columns * 2)
    full, half = divmod(halves, 2)
    return Text().append("━" * full + "╸" * half, style).append("─" * (columns - full - half), "dim")


# ---- numbers, rejections, events


def _numbers(state: GatewayState, rates: Counts | None, live: bool) -> list[Text]:
    spi, watchdog = state.spi, state.watchdog
    in_all = Counts.of(state)
    stops = watchdog.stop_latency_us
    latency = (
        "latency: none so far"
        if stops.p50 is None or stops.p99 is None or stops.max is None
        else f"p50 {stops.p50 / 1e3:.1f} p99 {stops.p99 / 1e3:.1f} max {stops.max / 1e3:.1f} ms"
    )
    head = Text("           accepted  rejected replaced   frames ", "dim")
    head.append(f"  {spi.errors} SPI error{'' if spi.errors == 1 else 's'}", "bold red" if spi.errors else "dim")
    head.append(f" ({spi.framing}, {'simulated' if state.simulated else spi.device})", "dim")
    rate = Text().append("per second ", "dim")
    for each in ("—",) * len(in_all) if rates is None or not live else (f"{value:.1f}" for value in rates):
        rate.append(f"{each:>8} ")
    rate.append(
        f"  watchdog expired {watchdog.expirations} time{'' if watchdog.expirations == 1 else 's'}",
        "yellow" if watchdog.expirations else "dim",
    )
    total = Text().append("in all     ", "dim")
    for count in in_all:
        total.append(f"{count:>8} ")
    total.append(f"  Stop {latency}", "dim")
    return [head, rate, total]


def _rejections(model: Model) -> list[Text]:
    line = Text().append("rejected    ", "dim")
    if not model.rejected:
        return [line.append("nobody, since this view began", "dim")]
    for source, count in model.rejected.most_common(_MAX_SOURCES):
        line.append(f"{source} ", "yellow").append(f"{count} ", "bold yellow")
        line.append(f"({model.reasons.get(source, '?')})  ", "dim")
    if len(model.rejected) > _MAX_SOURCES:
        line.append(f"and {len(model.rejected) - _MAX_SOURCES} more sources", "dim")
    return [line]


def _events(model: Model, width: int, room: int) -> list[Text]:
    lines: list[Text] = []
    for event in list(model.lines)[:room]:
        style = "bold red" if event.bad else "yellow" if tone_of(event.kind) == "warn" else "cyan"
        first, *more = _wrapped(event.text, max(20, width - _EVENT_COLUMNS), 2)
        head = Text().append(f"{event.time.astimezone():%H:%M:%S} ", "dim").append(f"{event.kind:16} ", style)
        lines.append(head.append(first))
        lines += [Text(" " * _EVENT_COLUMNS + row) for row in more]
    return lines
