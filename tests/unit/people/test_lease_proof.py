"""What a client sends to show who it is: its certificate, and a nonce signed with the key of it."""

import datetime as dt
import json
from pathlib import Path

import pytest
import zenoh
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec

from gateway import certs
from gateway.errors import ConfigError
from gateway.people.client.requests import Identity

NONCE = "0123456789abcdef" * 2


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
    request = {"do": "acquire", "source": "a" * 64, "proof": anna(folder).prove("acquire", "a" * 64, NONCE)}
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
            Identity(folder / "anna.pem", tmp_path / name).prove("ask", "anna", NONCE)
    with pytest.raises(ConfigError, match="cannot read the key"):
        Identity(folder / "anna.pem", tmp_path / "absent.key").prove("ask", "anna", NONCE)


def test_a_certificate_without_a_person_is_one_sentence(tmp_path: Path) -> None:
    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, "operator")])
    made = x509.CertificateBuilder().subject_name(name).issuer_name(name).public_key(key.public_key())
    now = dt.datetime.now(dt.UTC)
    made = made.serial_number(1).not_valid_before(now).not_valid_after(now + dt.timedelta(days=1))
    (tmp_path / "nobody.pem").write_bytes(made.sign(key, hashes.SHA256()).public_bytes(serialization.Encoding.PEM))
    with pytest.raises(ConfigError, match="names no person"):
        Identity(tmp_path / "nobody.pem", tmp_path / "nobody.key").person()
