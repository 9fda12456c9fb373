"""What `calibrate` shows: the servo under test, what the keys do, and the table of all 18."""

from typing import Final

from rich.text import Text

from gateway.people.tools.calibrate.session import Asks, Session
from gateway.robot.core.calibration import AS_DRAWN, ServoCalibration
from gateway.robot.protocol.frames import MAX_ANGLE_CDEG
from schemas.robot import JOINTS, LEGS

_SERVO_KEYS: Final = """\
leg, joint, Enter: test a servo, such as 32      Space: Stop, all legs
w: write what has changed     u: undo     q: leave
"""
_RUN_KEYS: Final = """\
← →  1°     ↓ ↑  0.1°     (hold to go on)       Space, Esc: Stop
=  measured: it now stands at …                 i  it goes the wrong way
[  not below here     ]  not above here   f  full range   d  as drawn   u  undo
"""
_TOP_ROWS: Final = 6
_MESSAGE_ROWS: Final = 3
"""So that the table stays where it is."""
_BAR: Final = 60
"""Columns of the bar, three degrees each; fewer in a narrow terminal."""
_BESIDE_BAR: Final = 11
_SLOW_S: Final = 0.3
_LEAST_ROWS: Final = 20
_LEAST_COLUMNS: Final = 79
"""In a lower or narrower terminal the table is left out, and what has happened stands above the keys: lines that wrap
would push it off the screen, with a Stop that nobody has confirmed."""
_CELL: Final = 24


def picture(session: Session, where: str, rows: int, columns: int) -> Text:
    """The whole screen, with the session's lock held."""
    text = Text()
    driver = "you drive" if session.drives else "you do not drive"
    text.append(f" calibrate   {where}   revision {session.guide.in_force.revision}   {driver}\n\n", "bold")
    top, message = Text(), Text()
    _top(top, session, min(_BAR, max(columns - _BESIDE_BAR, 1)))
    _message(message, session)
    if rows < _LEAST_ROWS or columns < _LEAST_COLUMNS:
        message.append("\n" * (not message.plain.endswith("\n")))
        text.append_text(message).append("\n").append_text(top)
        text.append(f"The table of all servos needs {_LEAST_COLUMNS} columns and {_LEAST_ROWS} rows.\n", "dim")
        return text
    for lines, least in ((top, _TOP_ROWS), (message, _MESSAGE_ROWS)):
        text.append_text(lines)
        text.append("\n" * (least - lines.plain.count("\n")))
    _table(text, session)
    return text


def _top(text: Text, session: Session, bar: int) -> None:
    match session.asks:
        case Asks.KEYS | Asks.MEASURED:
            _running(text, session, bar)
        case Asks.ANGLE:
            _ask(text, f"Servo {session.servo_id} goes there AT ONCE, wherever it stands now. Start it at: ", session)
            text.append("Enter: start it   another angle: type it   Esc: no\n", "dim")
        case Asks.WRITE:
            names = ", ".join(map(str, session.guide.changed))
            text.append(f" Write the calibration of servo {names}? y: yes   any other key: no \n", "black on yellow")
            left_out = ", ".join(map(str, session.guide.landing_left_out))
            if left_out:
                text.append(f"The landing pose loses servo {left_out}, which no longer gets there.\n")
        case Asks.LEAVE:
            text.append(" Leave without writing what has changed? y: yes   any other key: no \n", "black on yellow")
        case Asks.SERVO:
            _ask(text, "Servo: ", session)
            text.append(_SERVO_KEYS)


def _ask(text: Text, question: str, session: Session) -> None:
    text.append(question)
    text.append(f"{session.typed}_\n", "bold")


def _running(text: Text, session: Session, bar: int) -> None:
    guide, held = session.guide, session.held
    servo_id = guide.servo_id or 0
    runs = held.holding.confirmed
    text.append(f" servo {servo_id} {'RUNS at' if runs else 'is started at'} {guide.shown_deg:g}° ", "black on green")
    if guide.in_force.of(servo_id) != guide.draft[servo_id]:
        text.append(f"  {guide.command_deg:g}° by revision {guide.in_force.revision}, which is in force", "dim")
    text.append("\n")
    _bar(text, guide.draft[servo_id], round(guide.shown_deg * 100), bar)
    if session.asks is Asks.MEASURED:
        _ask(text, "Measured on the robot, it now stands at: ", session)
        text.append("Enter: this sets the trim   Esc: no\n", "dim")
    else:
        text.append(_RUN_KEYS)


def _bar(text: Text, servo: ServoCalibration, shown_cdeg: int, columns: int) -> None:
    """0 to 180 degrees, the limits, and where it stands."""
    place, low, high = (
        min(max(round(cdeg * columns / MAX_ANGLE_CDEG), 0), columns)
        for cdeg in (shown_cdeg, servo.min_cdeg, servo.max_cdeg)
    )
    text.append("   0 ")
    for column in range(columns + 1):
        inside = low <= column <= high
        mark = "[" if column == low else "]" if column == high else "━" if inside else "·"
        text.append("●" if column == place else mark, "bold green" if column == place else "" if inside else "dim")
    text.append(" 180\n")


def _message(text: Text, session: Session) -> None:
    held = session.held
    if held.holding.unconfirmed is not None:
        text.append(
            f" NOBODY HAS CONFIRMED THE STOP ({held.holding.unconfirmed}): switch the servos' power off \n",
            "white on red",
        )
    if held.stopping:
        text.append("Stop …", "bold")
    elif held.unanswered_s > _SLOW_S:
        text.append(f"NO ANSWER for {held.unanswered_s:.1f} s: the gateway's watchdog stops the servo", "bold red")
    else:
        text.append(session.message or session.busy, "bold")


def _table(text: Text, session: Session) -> None:
    text.append("     " + "".join(f"{f'joint {joint}':<{_CELL + 1}}" for joint in JOINTS).rstrip() + "\n", "dim")
    changed = session.guide.changed
    for leg in LEGS:
        text.append(f" {leg} ", "dim")
        for joint in JOINTS:
            servo_id = 10 * leg + joint
            words = f"{'*' if servo_id in changed else ' '}{words_of(session.guide.draft[servo_id])}"
            style = "reverse" if servo_id == session.guide.servo_id else "bold" if servo_id in changed else ""
            text.append(" ")
            text.append(f"{words:<{_CELL}}", style)
        text.append("\n")
    if changed:
        text.append("   * not written yet\n", "dim")


def words_of(servo: ServoCalibration) -> str:
    """At most 23 characters, unless each number has two decimals."""
    if servo == AS_DRAWN:
        return "as drawn"
    way = " inv" if servo.inverted else ""
    full = (servo.min_cdeg, servo.max_cdeg) == (0, MAX_ANGLE_CDEG)
    limits = "" if full else f" {servo.min_cdeg / 100:g}…{servo.max_cdeg / 100:g}"
    trim = f"{servo.trim_cdeg / 100:+g}°" if servo.trim_cdeg else "0°"
    return f"{trim}{way}{limits}"
