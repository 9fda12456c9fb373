"""How a client holds a lease: renewed by itself, lost only by the gateway's word or its silence, never told twice."""

import datetime as dt
import json
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import pytest
import zenoh
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from hypothesis import given
from hypothesis import strategies as st

from gateway import certs
from gateway.errors import ConfigError, DisconnectedError, LeaseError, LeaseLostError
from gateway.people.client.lease import TRY_AGAIN_S, Lease
from gateway.people.client.renewal import RENEWALS, Holds, Renewal
from gateway.people.client.requests import Identity
from schemas.lease import LeaseAck
from schemas.telemetry import Ack, Event, Kind, Reason
from tests.support.published import event

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


def renew(renewal: Renewal, answers: Iterable[LeaseAck | None]) -> list[float]:
    """As the thread does, with these answers (None: silence); when each renewal left, since the lease began."""
    left_s = []
    now_s = BEGUN_S
    for answer in answers:
        if renewal.holds is not Holds.YES:
            break
        now_s = max(now_s, renewal.due_s)
        left_s.append(now_s - BEGUN_S)
        renewal.asked(now_s)
        if answer is None:
            now_s += renewal.answer_s
            renewal.unanswered(now_s)
        else:
            renewal.answered(answer, now_s)
    return left_s


def test_a_gateway_that_is_silent_for_as_long_as_it_lives_has_lost_it() -> None:
    renewal = granted()
    left_s = renew(renewal, [None] * 10)
    assert len([each for each in left_s if each <= TTL_S + 1e-6]) == RENEWALS
    assert renewal.lost is not None
    assert (renewal.holds, renewal.lost.reason, renewal.lost.holder) == (Holds.LOST, Reason.NO_LEASE, None)
    assert "has not answered for 900 ms" in str(renewal.lost)
    assert not renewal.elsewhere, "the legs may still be ours, and are stopped at a stream's end"


@pytest.mark.parametrize(("answer", "holder", "elsewhere"), [(TAKEN, "bert", True), (FREE, None, False)])
def test_what_the_gateway_rejects_is_lost_at_once(answer: LeaseAck, holder: str | None, elsewhere: bool) -> None:
    renewal = granted()
    assert len(renew(renewal, [DONE, answer, DONE])) == 2
    assert renewal.lost is not None
    assert (renewal.lost.holder, renewal.lost.reason, renewal.elsewhere) == (holder, answer.reason, elsewhere)
    assert f"{holder or 'nobody'} holds it now" in str(renewal.lost)


STEPS = st.sampled_from(["confirmed", "taken", "silent", "gives", "keeps", "handed over", "released"])


@given(st.lists(st.tuples(STEPS, st.floats(0, 2 * TTL_S)), max_size=20))
def test_it_ends_once_whatever_crosses(steps: list[tuple[str, float]]) -> None:
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


class Told:
    """What is called back."""

    def __init__(self) -> None:
        self.lost: list[LeaseLostError] = []
        self.asked: list[str] = []
        self.once = threading.Event()
        self.answer: Callable[[str], None] = lambda _: None
        """What the holder does about it."""

    def on_lost(self, error: LeaseLostError) -> None:
        self.lost.append(error)
        self.once.set()

    def on_asked(self, who: str) -> None:
        self.answer(who)
        self.asked.append(who)
        self.once.set()


def lease_of(robot: Any, told: Told | None = None, *, wait_s: float = 0.0) -> Lease:
    told = told or Told()
    return Lease(robot, take=False, wait_s=wait_s, source=None, on_lost=told.on_lost, on_asked=told.on_asked)


def test_it_renews_by_itself_and_releases_at_the_end() -> None:
    robot = Robot()
    with lease_of(robot) as lease:
        robot.wait_for("renew", count=4)  # longer than it lives
        assert (lease.held, lease.holder, lease.verified, lease.ttl_ms) == (True, "anna", True, 60.0)
    assert robot.asked[0] == "acquire"
    assert robot.asked[-1] == "release"
    assert (lease.held, lease.token, lease.lost, robot.hears) == (False, None, None, None)


@pytest.mark.parametrize("kind", [Kind.LEASE_TAKEN, Kind.LEASE_EXPIRED, Kind.LEASE_RELEASED])
def test_an_event_only_raises_a_doubt_and_the_gateways_answer_decides(kind: Kind) -> None:
    robot = Robot(GRANTED.model_copy(update={"ttl_ms": 60_000}))
    with lease_of(robot) as lease:
        assert robot.hears is not None
        robot.hears(event(kind, "forged"))
        robot.wait_for("renew")  # at once, and not after 20 s
        assert lease.held


def test_a_rejected_command_asks_the_gateway_and_raises_what_is_lost() -> None:
    robot = Robot(GRANTED.model_copy(update={"ttl_ms": 60_000}))
    with lease_of(robot) as lease:
        lease.judge(Ack(accepted=False, reason=Reason.NOT_HOLDER, detail="forged"))
        assert lease.held
        robot.renewed = TAKEN
        lease.judge(Ack(accepted=False, reason=Reason.JOINT_LIMIT, detail="no"))
        assert lease.held
        with pytest.raises(LeaseLostError, match="bert holds it now"):
            lease.judge(Ack(accepted=False, reason=Reason.NOT_HOLDER, detail="bert drives"))


def test_who_asks_is_told_and_may_be_handed_it_from_the_callback() -> None:
    robot, told = Robot(GRANTED.model_copy(update={"ttl_ms": 60_000})), Told()
    with lease_of(robot, told) as lease:
        told.answer = lease.hand_over
        assert robot.hears is not None
        robot.hears(event(Kind.LEASE_ASKED, "bert asks", "bert"))
        assert told.once.wait(LATE_S)
        assert told.asked == ["bert"]
        assert (lease.held, lease.token, lease.elsewhere) == (False, None, True)
        with pytest.raises(LeaseError, match="not held"):
            lease.hand_over("bert")
    assert robot.asked[-1] == "release to bert"
    assert told.lost == []


def test_a_hand_over_that_is_rejected_changes_nothing() -> None:
    robot = Robot()
    with lease_of(robot) as lease:
        robot.released = LeaseAck(accepted=False, reason=Reason.INVALID, detail="carl has not asked")
        with pytest.raises(LeaseError, match="carl has not asked"):
            lease.hand_over("carl")
        assert lease.held


def test_while_somebody_else_drives_it_says_who() -> None:
    robot = Robot(HELD)
    with pytest.raises(LeaseError, match="lease_held: bert drives") as caught, lease_of(robot):
        raise AssertionError
    assert caught.value.holder == "bert"
    assert robot.asked == ["acquire"]
    assert robot.hears is None


@pytest.mark.lengthy
def test_it_asks_waits_and_is_handed_it() -> None:
    by_carl = HELD.model_copy(update={"holder": "carl"})
    robot = Robot(HELD, HELD, by_carl, by_carl, GRANTED)
    begun_s = time.monotonic()
    with lease_of(robot, wait_s=LATE_S):
        assert time.monotonic() - begun_s >= 4 * TRY_AGAIN_S
        again = ["acquire", "ask", "acquire", "acquire", "ask", "acquire", "acquire"]
        assert [each for each in robot.asked if each != "renew"] == again


@pytest.mark.parametrize("token", [None, "", TOKEN[1:], TOKEN.upper(), TOKEN + "\n"])
def test_what_is_no_token_is_carried_by_no_command(token: str | None) -> None:
    """Without access control anybody may answer, and a gateway rejects a command that carries something else."""
    robot = Robot(GRANTED.model_copy(update={"lease": token}))
    with pytest.raises(LeaseError, match="has no token"):
        lease_of(robot).acquire()
    assert (robot.carried_lease, robot.hears) == (None, None)


def test_a_client_holds_one_at_a_time() -> None:
    robot = Robot()
    with lease_of(robot):
        with pytest.raises(RuntimeError, match="holds a lease already"):
            lease_of(robot).acquire()
        assert robot.asked.count("acquire") == 1


@pytest.mark.parametrize(("renewed", "reason"), [(TAKEN, Reason.NOT_HOLDER), (SILENCE, Reason.NO_LEASE)])
def test_nothing_that_can_be_printed_of_a_lease_that_is_lost_has_the_token(
    renewed: LeaseAck | None, reason: Reason
) -> None:
    robot, told = Robot(), Told()
    with lease_of(robot, told) as lease:
        robot.renewed = renewed
        assert told.once.wait(LATE_S)
        assert told.lost[0].reason == reason
        assert TOKEN not in f"{lease} {lease!r} {told.lost[0]!r} {told.lost[0]} {GRANTED!r} {GRANTED}"


# ---- who it is: its certificate, and a nonce signed with the key of it


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("certs") / "D"
    certs.folder.init(made, ["robot.local"])
    certs.folder.issue(made, "anna", "operator")
    return made


def anna(folder: Path) -> Identity:
    return Identity(folder / "anna.pem", folder / "anna.key")


def test_it_is_the_person_of_the_certificate_that_the_zenoh_file_names(folder: Path) -> None:
    config = zenoh.Config()
    assert not Identity.of(config).proves
    for name, file in (("connect_certificate", "anna.pem"), ("connect_private_key", "anna.key")):
        config.insert_json5(f"transport/link/tls/{name}", json.dumps(str(folder / file)))
    found = Identity.of(config)
    assert (found, found.proves) == (anna(folder), True)
    assert found.person() == "anna"


def test_it_fits_into_a_payload(folder: Path) -> None:
    request = {"do": "acquire", "source": "a" * 64, "proof": anna(folder).prove("acquire", "a" * 64, TOKEN)}
    assert len(json.dumps(request)) < 2048


def test_a_key_that_cannot_sign_is_one_sentence(folder: Path, tmp_path: Path) -> None:
    key = ec.generate_private_key(ec.SECP256R1())
    pem = serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8
    locked = serialization.BestAvailableEncryption(b"secret")
    for name, content, said in (
        ("locked.key", key.private_bytes(*pem, locked), "no unencrypted key"),
        ("rubbish.key", b"rubbish", "no unencrypted key"),
    ):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(ConfigError, match=said):
            Identity(folder / "anna.pem", tmp_path / name).prove("ask", "anna", TOKEN)
    with pytest.raises(ConfigError, match="cannot read the key"):
        Identity(folder / "anna.pem", tmp_path / "absent.key").prove("ask", "anna", TOKEN)


def test_a_certificate_without_a_person_is_one_sentence(tmp_path: Path) -> None:
    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, "operator")])
    made = x509.CertificateBuilder().subject_name(name).issuer_name(name).public_key(key.public_key())
    now = dt.datetime.now(dt.UTC)
    made = made.serial_number(1).not_valid_before(now).not_valid_after(now + dt.timedelta(days=1))
    (tmp_path / "nobody.pem").write_bytes(made.sign(key, hashes.SHA256()).public_bytes(serialization.Encoding.PEM))
    with pytest.raises(ConfigError, match="names no person"):
        Identity(tmp_path / "nobody.pem", tmp_path / "nobody.key").person()
