"""What the log looks like to a person and to the journal, and what Prometheus reads over HTTP."""

import http.client
import socket
import sys
import time
import urllib.error
import urllib.request
from datetime import datetime, timedelta
from pathlib import Path

import pytest
from prometheus_client.parser import text_string_to_metric_families

from gateway import __version__, certs
from gateway.model.frames import PROTOCOL_VERSION
from tests.support.command import run_program
from tests.support.gateway_process import free_port
from tests.support.pages import described, documented
from tests.support.secured import Secured


def read(address: str) -> str:
    with urllib.request.urlopen(f"http://{address}/metrics", timeout=10) as answer:
        return str(answer.read().decode())


def value(page: str, name: str, **labels: str) -> float:
    samples = [sample for family in text_string_to_metric_families(page) for sample in family.samples]
    (found,) = [sample.value for sample in samples if sample.name == name and labels.items() <= sample.labels.items()]
    return float(found)


def test_the_list_in_the_docs_is_the_page_and_no_web_page_reads_it_by_a_name_of_its_own(tmp_path: Path) -> None:
    """DNS rebinding, or a page of another origin. All cases: tests/unit/robot/test_telemetry.py."""
    port = free_port()
    here = f"127.0.0.1:{port}"
    settings = {"telemetry": {"metrics": f"0.0.0.0:{port}"}, "state": {"path": str(tmp_path / "box")}}
    with Secured(tmp_path, settings) as secured, secured.client("anna") as client, client.lease():
        assert client.estop().accepted
        page = read(here)
        assert value(page, "hexapod_sessions") == 1
        assert value(page, "hexapod_incidents_total") == 1
        assert value(page, "hexapod_build_info", version=__version__, protocol=PROTOCOL_VERSION) == 1
        expires = value(page, "hexapod_certificate_expiry_timestamp_seconds", file="gateway.pem")
        assert expires == pytest.approx(time.time() + certs.LEAF_DAYS * 86400, abs=100)
        for path in ("/", "/metric", "/metrics/more", "/favicon.ico"):
            with pytest.raises(urllib.error.HTTPError, match="404") as missing:
                urllib.request.urlopen(f"http://{here}{path}", timeout=10)
            missing.value.close()
        for headers, status in (
            ({"Host": here}, 200),
            ({"Host": f"127.0.0.2:{port}"}, 200),
            ({"Host": f"{socket.gethostname().partition('.')[0]}.local:{port}"}, 200),
            ({"Host": f"evil.example:{port}"}, 403),
            ({"Host": here, "Origin": "http://evil.example"}, 403),
        ):
            reached = "127.0.0.2" if "127.0.0.2" in headers["Host"] else "127.0.0.1"
            asked = http.client.HTTPConnection(reached, port, timeout=10)
            asked.request("GET", "/metrics", headers=headers)
            assert asked.getresponse().status == status, headers
            asked.close()
    assert described(page) == documented()


SPEAKER = """
import logging, sys, threading, warnings
from gateway.host import logs
from schemas.words import Kind, Reason
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
    """Return what SPEAKER writes to a pipe."""
    ran = run_program(sys.executable, *options, "-c", program, timeout=30)
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
