"""What the log looks like to a person, and to the journal."""

import subprocess
import sys
from datetime import datetime, timedelta

SPEAKER = """
import logging, sys, threading, warnings
from gateway.host import logs
from schemas.telemetry import Kind, Reason
logs.set_up()
logger = logging.getLogger("gateway.test")
logger.debug("detail")
logger.info("hexapod-gateway %s takes commands", 1, extra={
    "kind": Kind.STARTED, "source": None, "key": None, "reason": None})
logger.warning("leg 7 does not exist", extra={
    "kind": Kind.COMMAND_REJECTED, "source": "lap top", "key": "hexapod/leg/7/cmd", "reason": Reason.INVALID})
logger.warning("hostile \\x1b[2J\\nsecond line", extra={"source": "\\x1b]0;title\\x07\\u2028\\x9b"})
secret = "hunter2"
try:
    raise ValueError("broken")
except ValueError:
    logger.exception("something failed")
logging.getLogger("other.library").error("told too")
"""


def spoken(*options: str, program: str = SPEAKER) -> list[str]:
    """What SPEAKER writes to a pipe."""
    command = [sys.executable, *options, "-c", program]
    ran = subprocess.run(command, capture_output=True, text=True, check=True, timeout=30)
    assert ran.stdout == "", "results go to stdout, the log to stderr"
    return ran.stderr.removesuffix("\n").split("\n")


def test_each_line_has_its_time_and_level_and_none_is_anyones_words() -> None:
    lines = spoken("-X", "dev")
    assert [line.partition(" ")[2] for line in lines if line.startswith("20")] == [
        "[debug   ] detail",
        "[info    ] hexapod-gateway 1 takes commands kind=started",
        "[warning ] leg 7 does not exist key=hexapod/leg/7/cmd kind=command_rejected reason=invalid source='lap top'",
        r"[warning ] hostile \x1b[2J\nsecond line source='\x1b]0;title\x07\u2028\x9b'",
        "[error   ] something failed",
        "[error   ] told too",
    ]
    assert datetime.fromisoformat(lines[0].partition(" ")[0]).utcoffset() == timedelta(0)
    assert lines[-2] == "ValueError: broken"
    assert "hunter2" not in str(lines), "a traceback shows no values"


def test_lines_for_the_journal_begin_with_their_priority() -> None:
    """Only where stderr is the journal's own, as systemd says it by device and inode."""
    journal = "os.environ['JOURNAL_STREAM'] = f'{found.st_dev}:{found.st_ino}'"
    program = f"import os\nfound = os.fstat(2)\n{journal}\n{SPEAKER}"
    plain = spoken(program=program)
    assert plain[:2] == [
        "<6>hexapod-gateway 1 takes commands kind=started",
        "<4>leg 7 does not exist key=hexapod/leg/7/cmd kind=command_rejected reason=invalid source='lap top'",
    ]
    assert all(line.isprintable() for line in plain)
    detailed = spoken("-X", "dev", program=program)
    assert {line[:3] for line in detailed} == {"<7>", "<6>", "<4>", "<3>"}, "each line of a traceback, too"
    other = spoken(program="import os\nos.environ['JOURNAL_STREAM'] = '1:1'\n" + SPEAKER)
    assert not any(line.startswith("<") for line in other)
