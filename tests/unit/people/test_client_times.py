"""The client's rules of time in virtual time; what a gateway publishes; the causes of a failed connection."""

import asyncio
import datetime as dt
import doctest
import socket
import ssl
import threading
import time
from contextlib import suppress
from pathlib import Path
from queue import SimpleQueue
from types import ModuleType
from typing import Any, cast

import pytest
import zenoh

from gateway import certs
from gateway.certs import authority
from gateway.client import Client
from gateway.errors import UnreachedError
from gateway.people.client import pace, patience, payloads, renewal
from gateway.people.client.diagnosis import Stage, diagnose, validity
from gateway.people.client.lease_requests import Identity
from gateway.people.client.patience import ATTEMPT_S, OTHER_WAY_S, Patience, Query, QuestionStep
from gateway.people.client.subscriptions import KEPT_EVENTS
from gateway.people.commands import why
from gateway.people.commands.options import Reach
from gateway.people.console.link import GatewayLink
from gateway.people.console.pages.page_messages import Message, link_message
from gateway.people.walking import ride, words
from gateway.people.watching import confirmed_stop, silence
from gateway.people.watching.live import Live, OnLoop, Receiver
from gateway.people.watching.silence import WHY_EVERY_S, Silence
from gateway.zenoh.config import client_config, connect_endpoints
from schemas.gateway_state import GatewayState
from schemas.telemetry import Telemetry
from schemas.words import Kind
from tests.support.published import WALL, event, state

END_S = 10.0


def asked(*, again: bool = True, other_ways: bool = False) -> tuple[Patience[str], Query[str]]:
    """Return a question that was sent at 0 s."""
    patience: Patience[str] = Patience(0.0, END_S, again=again, other_ways=other_ways)
    return patience, patience.sent(0.0)


def test_the_dialled_programs_answer_counts_at_once() -> None:
    patience, query = asked()
    assert patience.step(0.001) is QuestionStep.WAIT
    patience.replied(query, "own", own=True)
    patience.replied(query, "later", own=True)
    assert (patience.step(0.002), patience.answer) == (QuestionStep.OVER, "own")


def test_anothers_answer_is_better_than_none_in_the_end() -> None:
    patience, query = asked()
    assert patience.step(ATTEMPT_S) is QuestionStep.AGAIN
    patience.replied(query, "foreign", own=False)
    patience.replied(query, "later", own=False)
    assert (patience.step(END_S), patience.answer) == (QuestionStep.OVER, "foreign")
    declined, query = asked()
    declined.replied(query, "foreign", own=False)
    declined.ended(query, 0.1)
    assert (declined.step(0.1), declined.answer) == (QuestionStep.OVER, "foreign"), "all have answered or declined"


def test_a_stop_without_an_answer_is_sent_again_each_second_until_its_end() -> None:
    patience, _ = asked()
    assert patience.next_s == ATTEMPT_S
    assert patience.step(ATTEMPT_S - 0.001) is QuestionStep.WAIT
    for number in range(1, 10):
        assert patience.step(number * ATTEMPT_S) is QuestionStep.AGAIN
        patience.sent(number * ATTEMPT_S)
        assert patience.step(number * ATTEMPT_S) is QuestionStep.WAIT
        assert patience.next_s == (number + 1) * ATTEMPT_S
    assert (patience.step(END_S), patience.answer) == (QuestionStep.OVER, None)


def test_while_another_query_is_under_way_a_lost_link_changes_nothing() -> None:
    patience, first = asked()
    patience.sent(0.1)
    patience.ended(first, 0.2)
    assert (patience.step(0.9), patience.next_s) == (QuestionStep.WAIT, ATTEMPT_S)


def test_what_is_no_stop_is_sent_once_and_ends_where_everybody_has_declined() -> None:
    patience, query = asked(again=False)
    assert patience.next_s == END_S
    assert patience.step(END_S - 0.001) is QuestionStep.WAIT
    patience.ended(query, 1.0)
    assert (patience.step(1.0), patience.answer) == (QuestionStep.OVER, None)
    assert asked(again=False)[0].step(END_S) is QuestionStep.OVER


def test_another_way_is_searched_for_once_and_at_once_if_the_link_is_lost() -> None:
    patience, _ = asked(other_ways=True)
    assert (patience.step(OTHER_WAY_S - 0.001), patience.next_s) == (QuestionStep.WAIT, OTHER_WAY_S)
    assert patience.step(OTHER_WAY_S) is QuestionStep.OTHER_WAY
    assert (patience.step(OTHER_WAY_S), patience.next_s) == (QuestionStep.WAIT, ATTEMPT_S)
    lost, query = asked(other_ways=True)
    lost.ended(query, 0.01)
    assert lost.step(0.01) is QuestionStep.OTHER_WAY
    assert lost.step(0.01) is QuestionStep.WAIT


# ---- how long a gateway has published nothing, and what pages are shown of that


MS = 1_000_000


def opened() -> Silence:
    silence = Silence()
    silence.opened(0)
    return silence


def test_where_no_session_can_be_opened_it_is_looked_why_at_once() -> None:
    silence = Silence()
    silence.not_opened()
    assert silence.must_diagnose(0)
    silence = opened()
    silence.not_opened()  # the link broke before the session had its subscriptions: its second has begun
    assert not silence.must_diagnose(1000 * MS)


def test_each_look_costs_the_robot_something_and_so_has_three_seconds_before_it() -> None:
    silence = opened()
    looks = []
    for ms in range(0, 10_000, 100):
        if silence.must_diagnose(ms * MS):
            looks.append(ms)
            silence.diagnosed((ms + 500) * MS)  # so long did it take
    assert looks == [1100, 4600, 8100]
    silence.received(10_000 * MS)
    assert not silence.must_diagnose(10_500 * MS), "it is back"
    assert WHY_EVERY_S == 3


# ---- what pages are shown


CONNECTED = link_message("connected")


class Shown:
    """A link to no gateway, and what it shows."""

    def __init__(self) -> None:
        self.messages = [link_message("gone")]
        self.link = GatewayLink(Reach(None, None, 1.0), "console", Receiver(), self.messages.append)

    @property
    def newest(self) -> Message:
        return self.messages[-1]

    def receive_state(self) -> None:
        self.link.received_state(state(), 0)

    def connect(self) -> None:
        self.link.received_token(True)
        self.receive_state()
        assert self.newest == CONNECTED


async def test_until_the_first_state_nobody_is_there() -> None:
    shown = Shown()
    shown.link.not_opened(UnreachedError("nobody listens"))
    assert shown.newest == link_message("gone", "nobody listens")
    shown.link.diagnosed(["its port is closed", "it is off"])
    shown.link.not_opened(UnreachedError("nobody listens"))
    assert shown.newest == link_message("gone", "its port is closed\nit is off"), "which says more"
    shown.receive_state()
    assert shown.newest == CONNECTED


@pytest.mark.parametrize("linked", [True, False])
async def test_a_gateway_that_hangs_is_silent_and_a_link_that_is_cut_is_gone(linked: bool) -> None:
    shown = Shown()
    shown.connect()
    shown.link.fell_silent(linked=linked)
    assert shown.newest["status"] == ("silent" if linked else "gone")
    shown.link.diagnosed(["its journal says why"])
    shown.link.fell_silent(linked=linked)
    assert shown.newest["detail"] == "its journal says why", "what was found goes on being shown"
    assert len(shown.messages) == 4, "and the same is sent once"
    shown.receive_state()
    assert shown.newest == CONNECTED


async def test_a_gateway_that_has_ended_is_gone_at_once_and_no_older_state_brings_it_back() -> None:
    shown = Shown()
    shown.connect()
    shown.link.received_token(False)
    ended = link_message("gone", "the gateway has ended, or the link to it has")
    assert shown.newest == ended
    shown.receive_state()  # which was under way
    shown.link.fell_silent(linked=True)  # to a router
    assert shown.newest == ended
    shown.connect()


@pytest.mark.parametrize(("module", "count"), [(pace, 15), (payloads, 4), (silence, 5)])
def test_the_examples_are_right(module: ModuleType, count: int) -> None:
    assert doctest.testmod(module) == (0, count)


TIMES: dict[tuple[ModuleType, str], float] = {
    (confirmed_stop, "AGAIN_NS"): 100_000_000,
    (confirmed_stop, "REQUESTS_AT_ONCE"): 4,
    (confirmed_stop, "MAX_PRESSES"): 16,
    (pace, "LATE_PART"): 0.5,
    (pace, "MOST_DEG"): 3.2,
    (pace, "SILENCE_S"): 0.5,
    (patience, "RESEND_S"): 0.05,
    (patience, "ATTEMPT_S"): 1.0,
    (patience, "OTHER_WAY_S"): 0.2,
    (renewal, "RENEWALS"): 3,
    (ride, "START_PAUSE_S"): 0.015,
    (silence, "CHECK_EVERY_S"): 0.1,
    (silence, "SILENT_MS"): 1000,
    (words, "NEWS_S"): 1.0,
}


def test_each_time_is_as_decided() -> None:
    assert {(module, name): getattr(module, name) for module, name in TIMES} == TIMES


# ---- to an event loop


class OnThisLoop(Receiver):
    """Keeps what it is called with."""

    def __init__(self) -> None:
        self.calls: list[tuple[object, ...]] = []

    def __getattribute__(self, name: str) -> Any:
        found = super().__getattribute__(name)
        return (lambda *arguments: self.calls.append((name, *arguments))) if callable(found) else found


def test_a_busy_loop_gets_the_newest_state_and_a_bounded_number_of_events() -> None:
    async def busy() -> list[tuple[object, ...]]:
        receiver = OnThisLoop()
        to_loop = OnLoop(asyncio.get_running_loop(), receiver)

        def flood() -> None:
            to_loop.opened()
            for number in range(KEPT_EVENTS + 3):
                to_loop.received_state(state(float(number)), number)
                to_loop.received_event(event(Kind.STOPPING, str(number)))
                to_loop.received_telemetry(Telemetry(time=WALL, age_ms=0.0, tilt_deg=number))
            to_loop.received_token(False)
            to_loop.diagnosed(["nobody is there"])

        thread = threading.Thread(target=flood)
        thread.start()
        thread.join()  # the loop does nothing meanwhile
        await asyncio.sleep(0)
        to_loop.received_token(True)
        await asyncio.sleep(0)
        return receiver.calls

    last = KEPT_EVENTS + 2
    assert asyncio.run(busy()) == [
        ("opened",),
        ("received_state", state(float(last)), last),
        *(("received_event", event(Kind.STOPPING, str(each)), 3 if each == 3 else 0) for each in range(3, last + 1)),
        ("received_telemetry", Telemetry(time=WALL, age_ms=0.0, tilt_deg=last)),
        ("received_token", False),
        ("diagnosed", ["nobody is there"]),
        ("received_token", True),
    ]


# ---- a connection that stays


class BreaksAtOnce:
    """A client whose link breaks before its session has a subscription."""

    join = None

    def __init__(self, closed: "SimpleQueue[BreaksAtOnce]") -> None:
        self.session = self.states = self
        self._closed = closed

    def declare_subscriber(self, _key: str, _ring: object) -> None:
        raise zenoh.ZError("the link is broken")

    def state(self, _timeout_s: float) -> GatewayState:
        raise zenoh.ZError("the link is broken")

    def close(self) -> None:
        self._closed.put(self)


def test_a_session_without_subscriptions_is_closed_before_the_next_is_opened() -> None:
    opened: SimpleQueue[BreaksAtOnce] = SimpleQueue()
    closed: SimpleQueue[BreaksAtOnce] = SimpleQueue()

    def connect() -> Client:
        opened.put(client := BreaksAtOnce(closed))
        return cast(Client, client)

    live = Live(connect, OnThisLoop(), lambda _: [])
    live.start()
    for _ in range(2):
        assert opened.get(timeout=10) is closed.get(timeout=10)
    live.close()


BEGIN = dt.datetime(2026, 1, 1, tzinfo=dt.UTC)
END = dt.datetime(2028, 1, 1, tzinfo=dt.UTC)
SECOND = dt.timedelta(seconds=1)
DAY = dt.timedelta(days=1)


@pytest.mark.parametrize(
    ("now", "said", "fix"),
    [
        (BEGIN, "anna.pem is good until 2028-01-01", ""),
        (END - SECOND, "anna.pem is good until 2028-01-01", ""),
        (END, "anna.pem expired on 2028-01-01", "certs renew"),
        (
            BEGIN - SECOND,
            "anna.pem is good from 2026-01-01 only, and this machine's clock states 2025-12-31",
            "set the",
        ),
        (
            dt.datetime(1970, 1, 1, tzinfo=dt.UTC),
            "this machine's clock states 1970-01-01, which is before",
            "set the clock",
        ),
    ],
)
def test_a_certificate_and_a_clock(now: dt.datetime, said: str, fix: str) -> None:
    finding = validity("anna.pem", BEGIN, END, now)
    assert finding.stage is Stage.CERTIFICATE
    assert finding.sentence.startswith(said)
    assert fix in finding.fix
    assert bool(finding.fix) is bool(fix)


@pytest.mark.parametrize(
    ("endpoint", "dialled"),
    [
        ("tcp/[fe80::1%wlan0]:7447", "tcp/[fe80::1]:7447#iface=wlan0"),
        ("[fe80::1%eth0.7]:7447", "tcp/[fe80::1]:7447#iface=eth0.7"),
        ("tcp/[::1]:7447", "tcp/[::1]:7447"),
    ],
)
def test_the_interface_of_a_link_local_address_is_zenohs(endpoint: str, dialled: str) -> None:
    assert connect_endpoints(client_config(endpoint)) == [dialled]


def test_a_name_of_a_link_local_address_needs_an_interface(monkeypatch: pytest.MonkeyPatch) -> None:
    """A name server's answer has none, and Zenoh connects nowhere. With `#iface=` it dials the name."""
    found = [(socket.AF_INET6, socket.SOCK_STREAM, 6, "", ("fe80::1", 7447, 0, 0))]
    monkeypatch.setattr(socket, "getaddrinfo", lambda *_, **__: found)
    *_, last = diagnose("tcp/robot.lan:7447", Identity(), time.monotonic() + 1)
    assert last.sentence == "robot.lan is fe80::1, which each network interface has for itself"
    assert last.fix == "dial tcp/robot.lan:7447#iface=INTERFACE, as `ip link` names it"
    *_, last = diagnose("tcp/robot.lan:7447#iface=lo", Identity(), time.monotonic() + 1)
    assert last.stage is Stage.TCP
    assert "interface" not in last.fix


@pytest.mark.parametrize("endpoint", ["tls/[2001:db8::7]:7447", "quic/robot:7447", "robot:7447", "tls/robot"])
def test_what_is_not_dialled_is_reported_at_once(endpoint: str) -> None:
    (finding,) = diagnose(endpoint, Identity(), time.monotonic() + 1)
    assert finding.stage is Stage.ENDPOINT
    assert finding.fix


@pytest.mark.parametrize(
    ("role", "sentence", "fix"),
    [
        ("gateway", "the robot's certificate has expired", "hexapod-gateway certs renew gateway"),
        ("operator", "the robot's certificate is no robot's, such as a laptop's", "setup --certs FOLDER"),
    ],
)
def test_a_robot_with_a_wrong_certificate(role: str, sentence: str, fix: str, tmp_path: Path) -> None:
    """Expired, as after two years in a cupboard: the service would not start with it, but one that runs goes on."""
    certs.folder.init(tmp_path, ["127.0.0.1"])
    certs.folder.issue(tmp_path, "anna", "operator")
    ca = certs.folder.load_ca(tmp_path)
    now = dt.datetime.now(dt.UTC)
    wrong = authority.make_leaf(ca, "gateway", "gateway", ["127.0.0.1"], 1, now - 2 * DAY)
    wrong = wrong if role == "gateway" else authority.make_leaf(ca, "operator-07", "bob", [], 9, now)
    (tmp_path / "old.pem").write_bytes(wrong.certificate_pem())
    (tmp_path / "old.key").write_bytes(wrong.key_pem())
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(tmp_path / "old.pem", tmp_path / "old.key")
    with socket.create_server(("127.0.0.1", 0)) as robot:

        def shake_hands() -> None:
            with suppress(OSError), robot.accept()[0] as connection:
                context.wrap_socket(connection, server_side=True)

        threading.Thread(target=shake_hands, daemon=True).start()
        identity = Identity(tmp_path / "anna.pem", tmp_path / "anna.key", tmp_path / "ca.pem")
        *_, last = diagnose(f"tls/127.0.0.1:{robot.getsockname()[1]}", identity, time.monotonic() + 10)
    assert last.sentence == sentence
    assert fix in last.fix


def test_a_certificate_that_has_run_out_meanwhile(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of somebody who watches: the link ends with it, and this is why."""
    certs.folder.init(tmp_path, ["127.0.0.1"])
    monkeypatch.setattr(certs.folder, "now_utc", lambda: dt.datetime.now(dt.UTC) - 2 * DAY)
    certs.folder.issue(tmp_path, "dora", "operator", days=1)
    (line,) = why.unreached(None, tmp_path / "dora.json5")
    assert "dora.pem expired on" in line
    assert "hexapod-gateway certs renew NAME --dir DIR" in line
