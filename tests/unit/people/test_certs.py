"""Certificates: files, modes, contents, chains; and the commands that make them."""

import datetime as dt
import ipaddress
import json
import re
from functools import partial
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import serialization
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID
from cryptography.x509.verification import PolicyBuilder, Store, VerificationError
from typer.testing import CliRunner

from gateway import certs
from gateway.certs import authority
from gateway.errors import ConfigError
from gateway.people.commands.certs import app
from gateway.zenoh_config import load_client_config, load_config
from tests.support.certs_folder import DAY, HOSTS, MADE_BY_INIT, NOW, fault, make_folder, mode, names

__all__ = ["make_folder"]  # a fixture


def test_init_makes_its_files_and_only_the_owner_reads_the_keys(folder: Path) -> None:
    assert names(folder) == MADE_BY_INIT
    assert mode(folder) == 0o700
    assert {path.name: mode(path) for path in folder.iterdir()} == {
        "ca.key": 0o600,
        "gateway.key": 0o600,
        "ca.pem": 0o644,
        "gateway.pem": 0o644,
        "gateway.json5": 0o644,
    }


def test_the_gateways_certificate_is_good_for_its_hosts_and_no_other(folder: Path) -> None:
    ca, gateway = certs.files.read_certificate(folder / "ca.pem"), certs.files.read_certificate(folder / "gateway.pem")
    trust = PolicyBuilder().store(Store([ca]))
    policy = trust.time(NOW)
    for host in HOSTS:
        name = x509.DNSName(host) if host.endswith("local") else x509.IPAddress(ipaddress.ip_address(host))
        assert policy.build_server_verifier(name).verify(gateway, [])[0] == gateway
    with pytest.raises(VerificationError):
        policy.build_server_verifier(x509.DNSName("other.local")).verify(gateway, [])
    with pytest.raises(VerificationError):
        trust.time(NOW + 731 * DAY).build_server_verifier(x509.DNSName("robot.local")).verify(gateway, [])


def test_a_laptops_certificate_carries_role_and_name_and_cannot_serve(folder: Path) -> None:
    certs.folder.issue(folder, "alice", "operator", now=NOW)
    ca, alice = certs.files.read_certificate(folder / "ca.pem"), certs.files.read_certificate(folder / "alice.pem")
    alice.verify_directly_issued_by(ca)
    # The first common name, the only one, is all that Zenoh looks at.
    assert [a.value for a in alice.subject.get_attributes_for_oid(NameOID.COMMON_NAME)] == ["operator-00"]
    assert [a.value for a in alice.subject.get_attributes_for_oid(NameOID.ORGANIZATIONAL_UNIT_NAME)] == ["alice"]
    usage = alice.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value
    assert list(usage) == [ExtendedKeyUsageOID.CLIENT_AUTH]
    assert not alice.extensions.get_extension_for_class(x509.BasicConstraints).value.ca
    key = serialization.load_pem_private_key((folder / "alice.key").read_bytes(), None)
    assert key.public_key() == alice.public_key()


def test_a_consoles_certificate_only_serves(folder: Path) -> None:
    """At most 825 days, or Apple's browsers reject it; no role on Zenoh; no client."""
    hosts = ["robot.local", "192.0.2.7", "robot.local", "2001:db8::7"]
    made = certs.folder.issue(folder, "web", "console", hosts=hosts, days=3000, now=NOW)
    assert {path.name for path in made} == {"web.pem", "web.key", "web-ca.pem", "web-ca.key"}
    assert mode(folder / "web.key") == mode(folder / "web-ca.key") == 0o600
    for days in (None, 3000):
        if days is not None:
            certs.folder.renew(folder, "web", days=days, now=NOW)
        certificate = certs.files.read_certificate(folder / "web.pem")
        assert certificate.not_valid_after_utc - certificate.not_valid_before_utc <= 825 * DAY
        assert authority.holder_of(certificate) == ("console", "web")
        assert authority.hosts_of(certificate) == ["robot.local", "192.0.2.7", "2001:db8::7"]
        usage = certificate.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value
        assert list(usage) == [ExtendedKeyUsageOID.SERVER_AUTH]
    for name, given, sentence in (
        ("other", ["192.0.2.999"], "neither a host name"),
        ("other", [], "name at least one host"),
        ("web", ["robot.local"], "is taken"),
        ("gateway", ["robot.local"], "cannot be a name here"),
    ):
        assert sentence in fault(partial(certs.folder.issue, folder, name, "console", hosts=given))


def test_a_further_robot_has_a_folder_that_is_installed_like_the_first_ones(folder: Path) -> None:
    made = certs.folder.issue(folder, "robot-2", "robot", hosts=["robot-2.local"], now=NOW)
    assert {path.relative_to(folder / "robot-2").name for path in made} == {
        "gateway.json5", "gateway.pem", "gateway.key", "ca.pem",
    }  # fmt: skip
    assert mode(folder / "robot-2" / "gateway.key") == 0o600
    assert load_config(folder / "robot-2" / "gateway.json5")
    certs.folder.issue(folder, "anna", "operator", now=NOW)
    dialled = {
        name: json.loads(load_client_config(folder / name).get_json("connect/endpoints"))
        for name in ("anna.json5", "anna.robot-2.json5")
    }
    assert dialled == {
        "anna.json5": ["tls/robot.local:7447", "tls/192.0.2.7:7447"],
        "anna.robot-2.json5": ["tls/robot-2.local:7447"],
    }
    assert [(each.role, each.name) for each in certs.folder.expiries(folder)[1:]] == [
        ("gateway", "robot-2.local"), ("gateway", "robot.local"), ("operator", "anna"),
    ]  # fmt: skip
    certs.folder.renew(folder, "robot-2", hosts=["192.0.2.8"], now=NOW)
    renewed = certs.files.read_certificate(folder / "robot-2" / "gateway.pem")
    assert authority.hosts_of(renewed) == ["robot-2.local", "192.0.2.8"]
    for name, role, hosts, sentence in (
        ("robot-2", "robot", ["robot-3.local"], "is taken"),
        ("robot-3", "robot", [], "name at least one host"),
        ("bert", "operator", ["robot-2.local"], "nobody dials a laptop"),
    ):
        assert sentence in fault(partial(certs.folder.issue, folder, name, role, hosts=hosts))


# --- the commands


def run(*arguments: str) -> tuple[int, str]:
    result = CliRunner().invoke(app, list(arguments))
    if isinstance(result.exception, ConfigError):
        return result.exception.exit_code, str(result.exception)
    assert result.exception is None or isinstance(result.exception, SystemExit)
    return result.exit_code, result.output


def test_the_commands_from_init_to_list(tmp_path: Path) -> None:
    directory, bundle = str(tmp_path / "D"), str(tmp_path / "alice.zip")
    assert run("init", "--dir", directory, "--host", "robot.local", "--host", "192.0.2.7")[0] == 0
    code, text = run("issue", "alice", "--role", "operator", "--dir", directory, "--bundle", bundle, "--days", "90")
    assert (code, "alice.json5" in text, bundle in text) == (0, True, True)
    code, text = run("list", "--dir", directory)
    rows = [re.split("  +", line) for line in text.splitlines()]
    assert rows[0] == ["NAME", "ROLE", "EXPIRES", "COMMON NAME", "STATE"]
    assert [row[1] for row in rows[1:]] == ["ca", "gateway", "operator"]
    assert (rows[3][0], rows[3][2:]) == (
        "alice",
        [f"{dt.datetime.now(dt.UTC) + 90 * DAY:%Y-%m-%d}", "operator-00", "good"],
    )
    listed = json.loads(run("list", "--dir", directory, "--json")[1])
    assert [list(each.values()) for each in listed] == rows[1:]
    assert listed[2]["common_name"] == "operator-00"
    code, text = run("issue", "web", "--role", "console", "--dir", directory, "--host", "robot.local")
    assert (code, "--cert web.pem --key web.key" in text) == (0, True)
    assert run("renew", "alice", "--dir", directory)[0] == 0


def test_the_commands_fail_with_one_line_and_code_2(tmp_path: Path) -> None:
    directory = str(tmp_path / "D")
    assert run("init", "--dir", directory, "--host", "robot.local")[0] == 0
    for arguments in (
        ["init", "--dir", directory, "--host", "robot.local"],
        ["issue", "../alice", "--role", "operator", "--dir", directory],
        ["list", "--dir", str(tmp_path / "nowhere")],
    ):
        code, text = run(*arguments)
        assert code == 2
        assert len(text.splitlines()) == 1


@pytest.mark.parametrize("command", ["init", "issue", "list", "renew", "revoke"])
def test_every_help_has_an_example(command: str) -> None:
    code, text = run(command, "--help")
    assert code == 0
    assert f"hexapod-gateway certs {command}" in " ".join(text.split())
