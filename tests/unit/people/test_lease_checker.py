"""Who asks for the lease: proofs, made as a laptop makes them, and every way in which one is none."""

import base64
import datetime as dt
import json
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec, ed25519, padding, rsa
from cryptography.x509.oid import NameOID

from gateway.certs import authority
from gateway.certs.proof import WATCHING, Nonces, ProofChecker
from gateway.people.client.lease_requests import Identity
from gateway.robot.core.events import RequestAnswer, Sender
from gateway.robot.core.message import Reply
from gateway.robot.core.rejections import Rejection
from gateway.robot.runtime.conductor import Conductor
from gateway.robot.runtime.request_answers import CHECKS_PER_S, NONCE_NS, ButtonAnswers, LeaseAnswers
from gateway.robot.settings import Settings
from schemas.lease import Proof, signed_text
from schemas.words import Reason
from tests.support.certs_folder import with_one_bit_changed

NOW = dt.datetime(2026, 11, 22, tzinfo=dt.UTC)
DAY = dt.timedelta(days=1)
NONCE = "0123456789abcdef" * 2
CA = authority.make_ca(NOW)
OTHER_CA = authority.make_ca(NOW)
ANNA = authority.make_leaf(CA, "operator", "anna", (), 30, NOW)
BERT = authority.make_leaf(CA, "operator", "bert", (), 30, NOW)
CHECKER = ProofChecker([CA.certificate])
SIGNED = ANNA.certificate.tbs_certificate_bytes


def pem(certificate: x509.Certificate) -> str:
    return certificate.public_bytes(serialization.Encoding.PEM).decode()


def proof(
    pair: authority.KeyPair = ANNA, do: str = "acquire", nonce: str = NONCE, watching: str = "", **more: Any
) -> Proof:
    """Return a proof as `pair` makes it, to drive or with this name to watch; `more` overrides its fields."""
    text = WATCHING.signed("register", watching, nonce) if watching else signed_text(do, "anna", nonce)
    signature = pair.key.sign(text, ec.ECDSA(hashes.SHA256()))
    fields = {"nonce": nonce, "certificate": pem(pair.certificate), "signature": base64.b64encode(signature).decode()}
    return Proof.model_validate({**fields, **more})


def own_certificate(key: Any, name: x509.Name, **changes: Any) -> x509.Certificate:
    """Return what somebody's own tools make with this gateway's CA."""
    issuer = changes.get("issuer", CA)
    made = x509.CertificateBuilder().subject_name(name).issuer_name(issuer.certificate.subject)
    made = made.public_key(key.public_key()).serial_number(7)
    made = made.not_valid_before(changes.get("start", NOW - DAY)).not_valid_after(NOW + DAY)
    return made.sign(issuer.key, hashes.SHA256())


def name_of(role: str, person: str) -> x509.Name:
    return x509.Name(
        [x509.NameAttribute(NameOID.COMMON_NAME, role), x509.NameAttribute(NameOID.ORGANIZATIONAL_UNIT_NAME, person)]
    )


# ---- what is one


def test_an_rsa_key_and_a_certificate_of_somebodys_own_tools(tmp_path: Path) -> None:
    key = rsa.generate_private_key(65537, 2048)
    certificate = own_certificate(key, name_of("operator", "änne"))
    (tmp_path / "own.pem").write_text(pem(certificate))
    (tmp_path / "own.key").write_bytes(
        key.private_bytes(
            serialization.Encoding.PEM, serialization.PrivateFormat.TraditionalOpenSSL, serialization.NoEncryption()
        )
    )
    made = Proof.model_validate(Identity(tmp_path / "own.pem", tmp_path / "own.key").prove("take", "änne", NONCE))
    assert CHECKER.fault(made, "take", "änne", NOW) is None
    wrong = key.sign(signed_text("take", "änne", NONCE), padding.PKCS1v15(), hashes.SHA512())
    assert CHECKER.fault(made.model_copy(update={"signature": base64.b64encode(wrong).decode()}), "take", "änne", NOW)


@pytest.mark.parametrize(
    ("role", "source", "fault"),
    [
        ("button", "anna", None),
        ("button", "anna/phone", None),
        ("operator", "anna/phone", None),
        ("observer", "anna", "not that of an operator or a button of this robot"),
        ("button", "bert/anna", "source is not the person"),
    ],
)
def test_who_may_watch_with_a_hand_on_a_stop_and_under_which_names(role: str, source: str, fault: str | None) -> None:
    anna = authority.make_leaf(CA, role, "anna", (), 30, NOW)
    found = CHECKER.fault(proof(anna, watching=source), "register", source, NOW, WATCHING)
    assert found is None if fault is None else fault in str(found)


# ---- what is none

SELF_SIGNED = ec.generate_private_key(ec.SECP256R1())
ED = ed25519.Ed25519PrivateKey.generate()
OPERATOR = name_of("operator", "anna")


def issued(role: str = "operator", ca: authority.KeyPair = CA, now: dt.datetime = NOW) -> Proof:
    return proof(authority.make_leaf(ca, role, "anna", (), 30, now))


def by_own_tools(name: x509.Name = OPERATOR, key: Any = ANNA.key, **changes: Any) -> Proof:
    return proof(certificate=pem(own_certificate(key, name, **changes)))


UNSIGNED, FORGED = "is not signed by this gateway's CA", "proof.signature is not made"
RUBBISH = "-----BEGIN CERTIFICATE-----\nAAAA\n-----END CERTIFICATE-----\n"
NO_OPERATOR, NO_PEM = "not that of an operator", "no X.509 certificate in PEM form"
BAD: dict[str, tuple[Callable[[], Proof], str]] = {
    "another verb's": (lambda: proof(do="ask"), FORGED),
    "another nonce's": (lambda: proof(nonce="f" * 32).model_copy(update={"nonce": NONCE}), FORGED),
    "another person's name": (lambda: proof(BERT), "source is not the person"),
    "another person's key": (lambda: proof(BERT, certificate=pem(ANNA.certificate)), FORGED),
    "another CA's": (lambda: issued(ca=OTHER_CA), UNSIGNED),
    "one that only names the CA": (
        lambda: by_own_tools(key=SELF_SIGNED, issuer=authority.KeyPair(CA.certificate, SELF_SIGNED)),
        UNSIGNED,
    ),
    "the CA itself": (lambda: proof(CA), NO_OPERATOR),
    "an observer's": (lambda: issued("observer"), NO_OPERATOR),
    "an expired one's": (lambda: issued(now=NOW - 31 * DAY), "expired at"),
    "one of tomorrow": (
        lambda: by_own_tools(start=NOW + DAY / 2),
        "is valid from 2026-11-22 12:00 UTC; the robot's clock states 2026-11-22 00:00",
    ),
    "without a person": (lambda: by_own_tools(x509.Name(OPERATOR.rdns[:1])), "source is not the person"),
    "of a key of another kind": (lambda: by_own_tools(key=ED), FORGED),
    "rubbish in PEM": (lambda: proof(certificate=RUBBISH), NO_PEM),
    "no base64": (lambda: proof(signature=f"§{proof().signature}"), FORGED),
    "base64 with more in it": (lambda: proof(signature=f"!{proof().signature}"), FORGED),
}


@pytest.mark.parametrize(("make", "sentence"), BAD.values(), ids=BAD)
def test_what_is_no_proof(make: Callable[[], Proof], sentence: str) -> None:
    fault = CHECKER.fault(make(), "acquire", "anna", NOW)
    assert fault is not None
    assert sentence in fault
    assert "\n" not in fault


def test_a_robot_whose_clock_is_plainly_wrong_says_so() -> None:
    fault = CHECKER.fault(proof(), "acquire", "anna", dt.datetime(1970, 1, 1, 0, 2, tzinfo=dt.UTC))
    assert fault == CHECKER.clock_fault(dt.datetime(1970, 1, 1, 0, 2, tzinfo=dt.UTC))
    assert "this robot's clock is wrong: it shows 1970-01-01 00:02 UTC" in str(fault)
    assert CHECKER.clock_fault(NOW) is None


def test_who_drives_has_no_name_of_a_button() -> None:
    assert "source is not the person" in str(CHECKER.fault(proof(), "acquire", "anna/phone", NOW))


@pytest.mark.filterwarnings("ignore:.*RFC 5280")
def test_of_a_certificate_with_one_bit_changed_only_what_the_ca_signed_is_taken() -> None:
    """And no exception of a parser ends the service."""
    made = proof()
    for changed in with_one_bit_changed(pem(ANNA.certificate).encode()):
        fault = CHECKER.fault(made.model_copy(update={"certificate": changed.decode()}), "acquire", "anna", NOW)
        if fault is None:  # the bit has no meaning: how many bits of the signature's last byte are unused
            assert x509.load_pem_x509_certificate(changed).tbs_certificate_bytes == SIGNED


# ---- nonces


def test_few_nonces_are_remembered_the_newest() -> None:
    nonces = Nonces(NONCE_NS)
    for number in range(256 + 1):
        nonces.issue(str(number), number)
    assert not nonces.spend("0", 300)
    assert nonces.spend("1", 300)
    assert nonces.spend("256", 300)


# ---- the desk


class Desk:
    """Wants proofs, in a time of the test's; keeps what it would ask the conductor, and what it rejects."""

    def __init__(self, answers: LeaseAnswers | ButtonAnswers | None = None) -> None:
        self._answers = cast(Any, answers or LeaseAnswers(cast(Conductor, None), CHECKER, lambda: NOW))
        self._answers.ask, self._answers.reject = self.ask, self.reject
        self.now_ns = 1_000_000_000_000
        self.requests: list[Any] = []
        self.rejected: list[tuple[Sender, Reason, str]] = []

    def ask(self, request: object, reply: Reply) -> None:
        self.requests.append(request)
        reply(b"{}")

    def reject(self, sender: Sender, why: Rejection, reply: Reply, **_: object) -> None:
        self.rejected.append((sender, why.reason, why.detail))
        reply(b"{}")

    def answer_to(self, request: dict[str, Any]) -> Any:
        answers: list[bytes] = []
        self._answers.read(json.dumps(request).encode(), self.now_ns, answers.append)()
        (answer,) = answers
        return json.loads(answer)

    def nonce(self) -> str:
        return str(self.answer_to({"do": "challenge"})["nonce"])

    def claim(self, do: str, made: Proof | None, source: str = "anna") -> None:
        self.answer_to({"do": do, "source": source, **({} if made is None else {"proof": made.model_dump()})})


@pytest.mark.parametrize(
    ("names", "counts"),
    [((), True), (("bert", "anna"), True), (("operator",), True), (("button",), False), (("anna/phone",), False)],
)
def test_whoever_registers_a_button_proves_it_with_a_fresh_nonce(names: tuple[str, ...], counts: bool) -> None:
    conductor = SimpleNamespace(settings=Settings.of({"buttons": {"names": names}}))
    desk = Desk(ButtonAnswers(cast(Conductor, conductor), CHECKER, lambda: NOW))
    made = proof(nonce=desk.nonce(), watching="anna/phone")
    for each in (None, proof(do="register", nonce=desk.nonce()), made, made):
        desk.claim("register", each, "anna/phone")
    found = [(each.source, each.holder, each.counts) for each in desk.requests]
    assert found == [("anna/phone", "operator anna", counts)]
    assert [why[:2] for why in desk.rejected] == [(("anna/phone", None), Reason.BUTTON_DENIED)] * 3


def test_a_request_without_its_own_fresh_proof_is_denied() -> None:
    desk = Desk()
    failed, used, stale = (desk.nonce() for _ in range(3))
    forged = proof(BERT, nonce=failed, certificate=pem(ANNA.certificate))
    for made in (None, proof(), forged, proof(nonce=failed), proof(nonce=used), proof(nonce=used)):
        desk.claim("acquire", made)
    desk.now_ns += NONCE_NS
    desk.claim("acquire", proof(nonce=stale))
    assert len(desk.requests) == 1, "the first with a nonce that was good"
    assert {why[:2] for why in desk.rejected} == {(("anna", None), Reason.LEASE_DENIED)}
    of_nonces = ("none of this gateway's", "proof.signature", "has been used", "has been used", "older than 5 s")
    for (_, _, detail), sentence in zip(desk.rejected, ("proof is missing", *of_nonces), strict=True):
        assert sentence in detail


def test_a_flood_of_proofs_is_not_checked() -> None:
    desk = Desk()
    for _ in range(CHECKS_PER_S + 5):
        desk.claim("ask", proof(do="ask", nonce=desk.nonce()))
    assert len(desk.requests) == CHECKS_PER_S
    assert "too many proofs" in desk.rejected[0][2]
    desk.now_ns += 1_000_000_000 // CHECKS_PER_S
    desk.claim("ask", proof(do="ask", nonce=desk.nonce()))
    assert len(desk.requests) == CHECKS_PER_S + 1


def test_a_proved_name_is_verified() -> None:
    supervisor = SimpleNamespace(lease=SimpleNamespace(holder="anna"))
    conductor = cast(Conductor, SimpleNamespace(supervisor=supervisor, settings=Settings()))
    assert LeaseAnswers(conductor, CHECKER)._granted(RequestAnswer())["verified"] is True


def test_the_holder_of_a_token_proves_nothing() -> None:
    desk = Desk()
    desk.answer_to({"do": "renew", "lease": NONCE})
    desk.answer_to({"do": "release", "lease": NONCE, "to": "bert"})
    assert [(each.do, each.token, each.to) for each in desk.requests] == [
        ("renew", NONCE, None),
        ("release", NONCE, "bert"),
    ]
