"""How a client holds a lease: renewed by itself, lost only by the gateway's word or its silence, never told twice."""

import datetime as dt
import json
import os
import signal
import threading
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import zenoh
from cryptography import x509
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric import ec
from hypothesis import given
from hypothesis import strategies as st

from gateway import certs
from gateway.certs import authority
from gateway.errors import ConfigError, DisconnectedError, LeaseError, LeaseLostError
from gateway.people.client.lease import TRY_AGAIN_S, Lease
from gateway.people.client.lease_requests import Identity
from gateway.people.client.renewal import RENEWALS, Holds, Renewal
from schemas.ack import Ack
from schemas.event import Event
from schemas.lease import LeaseAck
from schemas.words import Kind, Reason
from tests.support.published import event
from tests.support.waiting import wait_until

# ---- when it is renewed and when it counts as lost, in virtual time


TTL_MS = 900.0
TTL_S = TTL_MS / 1000
BEGUN_S = 100.0
DONE = LeaseAck(accepted=True)
TAKEN = LeaseAck(accepted=False, reason=Reason.NOT_HOLDER, detail="bert drives", holder="bert")
FREE = LeaseAck(accepted=False, reason=Reason.NO_LEASE, detail="nobody drives")


def granted() -> Renewal:
    renewal = Renewal()
    renewal.granted(TTL_MS, BEGUN_S)
    return renewal


@pytest.mark.parametrize(
    ("answers", "reason", "holder", "sentence"),
    [
        ([None] * 10, Reason.NO_LEASE, None, "has not answered for 900 ms"),
        ([DONE, DONE, TAKEN, DONE], Reason.NOT_HOLDER, "bert", "bert holds it now"),
        ([DONE, DONE, FREE, DONE], Reason.NO_LEASE, None, "nobody holds it now"),
    ],
)
def test_a_lease_is_lost_at_once_by_the_gateways_word_and_by_a_silence_as_long_as_its_life(
    answers: list[LeaseAck | None], reason: Reason, holder: str | None, sentence: str
) -> None:
    """With these answers to what the thread sends (None: silence)."""
    renewal, now_s, left = granted(), BEGUN_S, 0
    for answer in answers:
        if renewal.holds is not Holds.YES:
            break
        now_s = max(now_s, renewal.due_s)
        left += now_s - BEGUN_S <= TTL_S + 1e-6
        renewal.asked(now_s)
        if answer is None:
            now_s += renewal.answer_s
            renewal.unanswered(now_s)
        else:
            renewal.answered(answer, now_s)
    assert left == RENEWALS
    assert renewal.lost is not None
    assert (renewal.holds, renewal.lost.reason, renewal.lost.holder) == (Holds.LOST, reason, holder)
    assert sentence in str(renewal.lost)
    assert renewal.elsewhere is (holder is not None), (
        "else the legs may still be ours, and are stopped at a stream's end"
    )


STEPS = st.sampled_from(["confirmed", "taken", "silent", "gives", "keeps", "handed over", "released"])


@given(st.lists(st.tuples(STEPS, st.floats(0, 2 * TTL_S)), max_size=20))
def test_a_lease_ends_once_whatever_crosses(steps: list[tuple[str, float]]) -> None:
    """A renewal that is rejected while it is given away is no loss, and what has ended stays as it ended."""
    renewal, now_s, confirmed_s, ended = granted(), BEGUN_S, BEGUN_S, Holds.YES
    for step, passed_s in steps:
        now_s += passed_s
        match step:
            case "confirmed":
                renewal.answered(DONE, now_s)
                confirmed_s = now_s
            case "taken":
                renewal.answered(TAKEN, now_s)
            case "silent":
                renewal.unanswered(now_s)
            case "gives" | "keeps":
                renewal.gives = step == "gives"
            case _:
                renewal.end(Holds.HANDED_OVER if step == "handed over" else Holds.RELEASED)
        if ended is Holds.YES:
            lost = step == "taken" or (step == "silent" and now_s - confirmed_s > TTL_S)
            if lost and not renewal.gives:
                ended = Holds.LOST
            elif step in ("handed over", "released"):
                ended = Holds.HANDED_OVER if step == "handed over" else Holds.RELEASED
        assert renewal.holds is ended
        assert (renewal.lost is not None) is (ended is Holds.LOST)


# ---- a client with its thread, and a gateway whose answers are set


TOKEN = "0123456789abcdef" * 2
LATE_S = 10
GRANTED = LeaseAck(accepted=True, lease=TOKEN, holder="anna", ttl_ms=60.0, verified=True)
LASTING = GRANTED.model_copy(update={"ttl_ms": 60_000})
HELD = LeaseAck(accepted=False, reason=Reason.LEASE_HELD, detail="bert drives", holder="bert")
SILENCE = None


class Robot:
    """A client and its gateway, whose answers to renewals and acquisitions are set; without one set: as in order."""

    def __init__(self, *acquired: LeaseAck) -> None:
        self.asked: list[str] = []
        self.changed = threading.Condition()
        self.acquired = deque(acquired or (GRANTED,))
        self.renewed: LeaseAck | None = DONE
        self.released = DONE
        self.name = "anna's laptop"
        self.carried_lease: Lease | None = None
        self.requests: Any = self
        self.hears: Callable[[Event], None] | None = None
        self.lost: list[LeaseLostError] = []
        self.answer: Callable[[str], None] = lambda _: None
        """What the holder does when somebody asks."""

    def note(self, what: str) -> None:
        with self.changed:
            self.asked.append(what)
            self.changed.notify_all()

    def wait_for(self, what: str, count: int = 1) -> None:
        with self.changed:
            assert self.changed.wait_for(lambda: self.asked.count(what) >= count, LATE_S), self.asked

    # ---- a client's side of it

    def on_event(self, callback: Callable[[Event], None]) -> "Robot":
        self.hears = callback
        return self

    def undeclare(self) -> None:
        self.hears = None

    def carry(self, lease: Lease) -> None:
        self.carried_lease = lease

    def on_lost(self, error: LeaseLostError) -> None:
        self.lost.append(error)
        self.note("lost")

    def on_asked(self, who: str) -> None:
        self.answer(who)
        self.note(f"asked by {who}")

    # ---- the gateway's

    def as_person(self, do: str, source: str | None) -> LeaseAck:
        del source
        self.note(do)
        return DONE if do == "ask" else self.acquired.popleft()

    def renew(self, token: str, timeout_s: float) -> LeaseAck:
        assert token == TOKEN
        assert timeout_s > 0
        answer = self.renewed
        self.note("renew")
        if answer is SILENCE:
            raise DisconnectedError("no gateway answered")
        return answer

    def release(self, token: str, to: str | None = None, timeout_s: float | None = None) -> LeaseAck:
        del timeout_s
        assert token == TOKEN
        self.note("release" if to is None else f"release to {to}")
        return self.released


def lease_of(robot: Any, *, wait_s: float = 0.0) -> Lease:
    return Lease(robot, take=False, wait_s=wait_s, source=None, on_lost=robot.on_lost, on_asked=robot.on_asked)


def test_a_lease_renews_itself_and_is_released_at_the_end() -> None:
    robot = Robot()
    with lease_of(robot) as lease:
        robot.wait_for("renew", count=4)  # longer than it lives
        assert (lease.held, lease.holder, lease.verified, lease.ttl_ms) == (True, "anna", True, 60.0)
        with pytest.raises(RuntimeError, match="holds a lease already"):
            lease_of(robot).acquire()
    assert robot.asked[0] == "acquire"
    assert robot.asked.count("acquire") == 1
    assert robot.asked[-1] == "release"
    assert (lease.held, lease.token, lease.lost, robot.hears) == (False, None, None, None)


@pytest.mark.parametrize("kind", [Kind.LEASE_TAKEN, Kind.LEASE_EXPIRED, Kind.LEASE_RELEASED])
def test_an_event_only_raises_a_doubt_and_the_gateways_answer_decides(kind: Kind) -> None:
    robot = Robot(LASTING)
    with lease_of(robot) as lease:
        assert robot.hears is not None
        robot.hears(event(kind, "forged"))
        robot.wait_for("renew")  # at once, and not after 20 s
        assert lease.held


def test_a_rejected_command_asks_the_gateway_and_raises_what_is_lost() -> None:
    robot = Robot(LASTING)
    with lease_of(robot) as lease:
        lease.judge(Ack(accepted=False, reason=Reason.NOT_HOLDER, detail="forged"))
        assert lease.held
        robot.renewed = TAKEN
        lease.judge(Ack(accepted=False, reason=Reason.JOINT_LIMIT, detail="no"))
        assert lease.held
        with pytest.raises(LeaseLostError, match="bert holds it now"):
            lease.judge(Ack(accepted=False, reason=Reason.NOT_HOLDER, detail="bert drives"))


def test_who_asks_is_told_and_may_be_handed_it_from_the_callback() -> None:
    robot = Robot(LASTING)
    with lease_of(robot) as lease:
        robot.answer = lease.hand_over
        assert robot.hears is not None
        robot.hears(event(Kind.LEASE_ASKED, "bert asks", "bert"))
        robot.wait_for("asked by bert")
        assert (lease.held, lease.token, lease.elsewhere) == (False, None, True)
        with pytest.raises(LeaseError, match="not held"):
            lease.hand_over("bert")
    assert robot.asked[-2:] == ["release to bert", "asked by bert"], "what is handed over is not released"
    assert robot.lost == []


def test_a_hand_over_that_is_rejected_changes_nothing() -> None:
    robot = Robot()
    with lease_of(robot) as lease:
        robot.released = LeaseAck(accepted=False, reason=Reason.INVALID, detail="carl has not asked")
        with pytest.raises(LeaseError, match="carl has not asked"):
            lease.hand_over("carl")
        assert lease.held


@pytest.mark.lengthy
def test_a_client_asks_for_the_lease_waits_and_is_handed_it() -> None:
    by_carl = HELD.model_copy(update={"holder": "carl"})
    robot = Robot(HELD, HELD, by_carl, by_carl, GRANTED)
    begun_s = time.monotonic()
    with lease_of(robot, wait_s=LATE_S):
        assert time.monotonic() - begun_s >= 4 * TRY_AGAIN_S
        again = ["acquire", "ask", "acquire", "acquire", "ask", "acquire", "acquire"]
        assert [each for each in robot.asked if each != "renew"] == again


def test_an_interruption_before_the_answer_gives_back_what_is_granted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody would know its token, so nobody could drive until it expires."""
    robot = Robot(LASTING)

    def interrupt_and_answer(do: str, source: str | None) -> LeaseAck:
        os.kill(os.getpid(), signal.SIGINT)
        wait_until(lambda: robot.hears is None, "the caller is interrupted")
        return Robot.as_person(robot, do, source)

    monkeypatch.setattr(robot, "as_person", interrupt_and_answer)
    with pytest.raises(KeyboardInterrupt), lease_of(robot):
        pytest.fail("the signal is lost")
    assert (robot.asked, robot.carried_lease) == (["acquire", "release"], None)


NO_TOKENS = (None, "", TOKEN[1:], TOKEN.upper(), TOKEN + "\n")


@pytest.mark.parametrize(
    ("answer", "sentence"),
    [
        (HELD, "lease_held: bert drives"),
        *((GRANTED.model_copy(update={"lease": each}), "has no token") for each in NO_TOKENS),
    ],
)
def test_while_somebody_else_drives_it_says_who_and_what_is_no_token_is_carried_by_no_command(
    answer: LeaseAck, sentence: str
) -> None:
    """Without access control anybody may answer, and a gateway rejects a command that carries something else."""
    robot = Robot(answer)
    with pytest.raises(LeaseError, match=sentence) as caught:
        lease_of(robot).acquire()
    assert (caught.value.holder, robot.carried_lease, robot.hears) == (answer.holder, None, None)
    assert robot.asked == ["acquire"]


@pytest.mark.parametrize(("renewed", "reason"), [(TAKEN, Reason.NOT_HOLDER), (SILENCE, Reason.NO_LEASE)])
def test_nothing_that_can_be_printed_of_a_lease_that_is_lost_has_the_token(
    renewed: LeaseAck | None, reason: Reason
) -> None:
    robot = Robot()
    with lease_of(robot) as lease:
        robot.renewed = renewed
        robot.wait_for("lost")
        (lost,) = robot.lost
        assert lost.reason == reason
        assert TOKEN not in f"{lease} {lease!r} {lost!r} {lost} {GRANTED!r} {GRANTED}"


# ---- who it is: its certificate, and a nonce signed with the key of it


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("certs") / "D"
    certs.folder.init(made, ["robot.local"])
    certs.folder.issue(made, "anna", "operator")
    return made


def test_the_holder_is_the_person_of_the_certificate_that_the_zenoh_file_names(folder: Path) -> None:
    config = zenoh.Config()
    assert not Identity.of(config).proves
    for name, file in (("connect_certificate", "anna.pem"), ("connect_private_key", "anna.key")):
        config.insert_json5(f"transport/link/tls/{name}", json.dumps(str(folder / file)))
    found = Identity.of(config)
    assert (found, found.proves) == (Identity(folder / "anna.pem", folder / "anna.key"), True)
    assert found.person() == "anna"
    request = {"do": "acquire", "source": "a" * 64, "proof": found.prove("acquire", "a" * 64, TOKEN)}
    assert len(json.dumps(request)) < 2048, "it fits into a payload"


def test_a_key_that_cannot_sign_and_a_certificate_without_a_person_are_one_sentence(
    folder: Path, tmp_path: Path
) -> None:
    key = tmp_path / "some.key"
    with pytest.raises(ConfigError, match="cannot read the key"):
        Identity(folder / "anna.pem", key).prove("ask", "anna", TOKEN)
    locked = serialization.BestAvailableEncryption(b"secret")
    made = ec.generate_private_key(ec.SECP256R1())
    pem = made.private_bytes(serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, locked)
    for content in (pem, b"rubbish"):
        key.write_bytes(content)
        with pytest.raises(ConfigError, match="no unencrypted key"):
            Identity(folder / "anna.pem", key).prove("ask", "anna", TOKEN)
    name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, "operator")])
    nobody = authority.sign(certs.folder.load_ca(folder), name, made.public_key(), (), 1, dt.datetime.now(dt.UTC))
    (tmp_path / "nobody.pem").write_bytes(nobody.public_bytes(serialization.Encoding.PEM))
    with pytest.raises(ConfigError, match="names no person"):
        Identity(tmp_path / "nobody.pem", key).person()
