"""What is reported: Prometheus's page over HTTP, the log for a person and for the journal, the configuration."""

import http.client
import json
import socket
import sys
import time
import urllib.request
from contextlib import closing
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
import zenoh
from prometheus_client.parser import text_string_to_metric_families

from gateway import __version__, certs
from gateway.errors import DisconnectedError, UnansweredError
from gateway.model.frames import PROTOCOL_VERSION
from gateway.people.client.lease_requests import Identity
from gateway.people.commands import why
from gateway.zenoh.config import client_config, open_session
from schemas import keys
from schemas.config import ConfigReport
from schemas.state import MAX_STATE_BYTES
from tests.support.command import run_program
from tests.support.gateway_process import Gateway, Secured, free_port
from tests.support.heard import Heard, states
from tests.support.pages import described, documented


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
        for path, host, origin, status in (
            ("/", "127.0.0.1", None, 404),
            ("/metrics/more", "127.0.0.1", None, 404),
            ("/metrics", "127.0.0.1", None, 200),
            ("/metrics", "127.0.0.2", None, 200),
            ("/metrics", f"{socket.gethostname().partition('.')[0]}.local", None, 200),
            ("/metrics", "evil.example", None, 403),
            ("/metrics", "127.0.0.1", "http://evil.example", 403),
        ):
            asked = http.client.HTTPConnection("127.0.0.2" if host == "127.0.0.2" else "127.0.0.1", port, timeout=10)
            asked.request("GET", path, headers={"Host": f"{host}:{port}", **({"Origin": origin} if origin else {})})
            assert asked.getresponse().status == status, (path, host, origin)
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


# ---- `hexapod/config`: published at the start, answered to a late reader, replaced by a restart


def settings(port: int, timeout_ms: int) -> dict[str, Any]:
    servos = {f"servos.{leg}{joint}": {"max_speed_deg_s": 90} for leg in range(1, 6) for joint in range(1, 4)}
    return {
        "zenoh": {"listen": [f"tcp/127.0.0.1:{port}"]},
        "watchdog": {"timeout_ms": timeout_ms},
        **{f"limits.{name}": values for name, values in servos.items()},
    }


def test_a_late_reader_asks_for_the_configuration_and_a_small_one_receives_each_state(tmp_path: Path) -> None:
    """One that takes messages of 2048 bytes receives the state, but no larger message."""
    with Gateway(tmp_path, settings(free_port(), 250)) as gateway, gateway.client() as client:
        (state,) = (reply.ok.payload.to_bytes() for reply in client.session.get(keys.STATE) if reply.ok)
        (config,) = (reply.ok.payload.to_bytes() for reply in client.session.get(keys.CONFIG) if reply.ok)
        read = ConfigReport.model_validate_json(config)
        assert read.config == json.loads(state)["config"]
        assert (read.watchdog.timeout_ms, len(read.limits.servos), read.calibration.revision) == (250, 18, 0)
        assert client.state().limits == read.limits
        small = client_config(gateway.endpoint)
        small.insert_json5("transport/link/rx", json.dumps({"buffer_size": 2048, "max_message_size": 2048}))
        small.insert_json5("transport/link/tx/batch_size", "2048")
        with closing(open_session(small)) as reader:
            states_read = reader.declare_subscriber(keys.STATE, zenoh.handlers.FifoChannel(8))
            larger = reader.declare_subscriber(keys.FRAME, zenoh.handlers.FifoChannel(8))
            for _ in range(2):
                assert len(states_read.recv().payload) <= MAX_STATE_BYTES
            client.session.put(keys.FRAME, "large" * MAX_STATE_BYTES)
            assert states_read.recv()
            client.session.put(keys.FRAME, "small")
            assert larger.recv().payload.to_string() == "small"


def test_who_watches_while_the_gateway_restarts_with_other_settings_reads_them(tmp_path: Path) -> None:
    port = free_port()
    with Gateway(tmp_path, settings(port, 250)) as gateway:
        client = gateway.client()
    with client:
        with Gateway(tmp_path, settings(port, 250)):
            seen, published = states(client), Heard(client, keys.CONFIG, ConfigReport)
            assert seen.wait(lambda _: True).watchdog.timeout_ms == 250
        with Gateway(tmp_path, settings(port, 300)):
            seen.wait(lambda state: state.watchdog.timeout_ms == 300)
            assert client.state().watchdog.timeout_ms == 300
            assert len({each.config for each in published.all}) == len(published.all), "once, not with each state"


def test_made_up_states_and_answers_hide_no_state_and_ask_little(tmp_path: Path) -> None:
    """Without access control any program may publish and answer."""
    with (
        Gateway(tmp_path, settings(free_port(), 250)) as gateway,
        gateway.client() as client,
        closing(open_session(client_config(gateway.endpoint))) as stranger,
    ):
        state, config = (
            next(reply.ok.payload.to_string() for reply in client.session.get(key) if reply.ok)
            for key in (keys.STATE, keys.CONFIG)
        )
        named = json.loads(state)["config"]
        asked: list[str] = []  # the configuration that the client has at each question

        def answer(query: zenoh.Query) -> None:
            with query:
                asked.append(client.states.config.config if client.states.config else "")
                query.reply(keys.CONFIG, config.replace(named, "ffffffff").replace("250", "999"))

        seen = states(client)
        declared = stranger.declare_queryable(keys.CONFIG, answer)
        begun_s = time.monotonic()
        for count in range(1, 4):
            for _ in range(100):
                stranger.put(keys.STATE, state.replace(named, "00000000"))
            assert seen.wait(lambda _: True, count=10 * count).watchdog.timeout_ms == 250
        assert 0 < len(asked) <= 2 + (time.monotonic() - begun_s) / 0.2
        assert set(asked) == {named}, "another program's answer counts for nothing"
        assert {each.watchdog.timeout_ms for each in seen.all} == {250}
        declared.undeclare()


OLDER_RULES = """{access_control: {
  enabled: true, default_permission: "allow",
  rules: [{id: "new", permission: "deny", flows: ["ingress"], messages: ["query"], key_exprs: ["hexapod/config"]}],
  subjects: [{id: "all"}], policies: [{rules: ["new"], subjects: ["all"]}],
}}"""


def test_access_rules_without_the_configuration_are_named_and_stop_no_stop(tmp_path: Path) -> None:
    file = tmp_path / "older.json5"
    file.write_text(OLDER_RULES)
    older = {"zenoh": {"listen": [f"tcp/127.0.0.1:{free_port()}"], "config": str(file)}}
    with Gateway(tmp_path, older) as gateway, gateway.client() as client:
        with pytest.raises(DisconnectedError, match=r"config is not: the access rules are of an older") as raised:
            client.state(0.5)
        assert not isinstance(raised.value, UnansweredError), "a gateway has answered"
        (finding,) = why.allowed(client, Identity.of(client_config(gateway.endpoint)))
        assert finding.stage == "gateway"
        assert finding.fix == "on the robot, `sudo hexapod-gateway check` names their file"
        assert client.stop().accepted
        assert client.estop().stop_frames == 6
