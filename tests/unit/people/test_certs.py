"""Certificates: files, modes, contents, chains, the commands that make them; and one sentence for each fault."""

import datetime as dt
import json
import os
import re
import shutil
import ssl
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from queue import SimpleQueue
from typing import Any, Final

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import serialization
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from gateway import certs
from gateway.certs import access, authority, revocation
from gateway.certs.files import publish
from gateway.certs.folder import load_ca
from gateway.certs.revocation import RevocationList, Revoked
from gateway.errors import ConfigError
from gateway.files import durable
from gateway.host.settings_table import ZenohSettings
from gateway.robot.runtime import revocations
from gateway.robot.settings import Settings
from gateway.zenoh.config import client_config, get, load_config
from schemas.revocation import RevocationAck
from tests.support.certs_folder import (
    DAY,
    HOSTS,
    NOW,
    contents,
    fault,
    make_folder,
    mode,
    names,
    with_one_bit_changed,
)
from tests.support.command import Ended, run_here
from tests.support.robot import Robot as HarnessedRobot

__all__ = ["make_folder"]  # a fixture


def test_init_makes_keys_that_only_the_owner_reads_and_a_certificate_for_the_gateways_hosts_alone(
    folder: Path,
) -> None:
    assert mode(folder) == 0o700
    assert {path.name: mode(path) for path in folder.iterdir()} == {
        "ca.key": 0o600,
        "gateway.key": 0o600,
        "ca.pem": 0o644,
        "gateway.pem": 0o644,
        "gateway.json5": 0o644,
    }
    for host in (*HOSTS, "other.local"):
        assert trusted(folder / "ca.pem", folder / "gateway.pem", folder / "gateway.key", host) == (host in HOSTS)


def test_a_laptops_certificate_carries_role_and_name_and_cannot_serve(folder: Path) -> None:
    certs.folder.issue(folder, "alice", "operator")
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
    """It is valid for at most 825 days, or Apple's browsers reject it. It has no role on Zenoh, and is no client's."""
    hosts = ["robot.local", "192.0.2.7", "robot.local", "2001:db8::7"]
    made = certs.folder.issue(folder, "web", "console", hosts=hosts, days=3000)
    assert {path.name for path in made} == {"web.pem", "web.key", "web-ca.pem", "web-ca.key"}
    assert mode(folder / "web.key") == mode(folder / "web-ca.key") == 0o600
    for days in (None, 3000):
        if days is not None:
            certs.folder.renew(folder, "web", days=days)
        for ca, trusts in (("web-ca.pem", True), ("ca.pem", False)):
            assert trusted(folder / ca, folder / "web.pem", folder / "web.key", "robot.local") is trusts
        certificate = certs.files.read_certificate(folder / "web.pem")
        assert certificate.not_valid_after_utc - certificate.not_valid_before_utc <= 825 * DAY
        assert authority.describe(certificate)[:3] == ("web", "console", "console")
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
    assert "keeps its own" in fault(lambda: certs.folder.renew(folder, "web", hosts=["192.0.2.8"]))


def test_a_further_robot_has_a_folder_that_is_installed_like_the_first_ones(folder: Path) -> None:
    made = certs.folder.issue(folder, "robot-2", "robot", hosts=["robot-2.local"])
    assert {path.relative_to(folder / "robot-2").name for path in made} == {
        "gateway.json5", "gateway.pem", "gateway.key", "ca.pem",
    }  # fmt: skip
    assert mode(folder / "robot-2" / "gateway.key") == 0o600
    assert load_config(folder / "robot-2" / "gateway.json5")
    certs.folder.issue(folder, "anna", "operator")
    dialled = {
        name: json.loads(client_config(None, folder / name).get_json("connect/endpoints"))
        for name in ("anna.json5", "anna.robot-2.json5")
    }
    assert dialled == {
        "anna.json5": ["tls/robot.local:7447", "tls/192.0.2.7:7447"],
        "anna.robot-2.json5": ["tls/robot-2.local:7447"],
    }
    certs.folder.renew(folder, "robot-2", hosts=["192.0.2.8"])
    renewed = certs.files.read_certificate(folder / "robot-2" / "gateway.pem")
    assert authority.hosts_of(renewed) == ["robot-2.local", "192.0.2.8"]
    for name, role, hosts, sentence in (
        ("robot-2", "robot", ["robot-3.local"], "is taken"),
        ("robot-3", "robot", [], "name at least one host"),
        ("bert", "operator", ["robot-2.local"], "nobody dials a laptop"),
    ):
        assert sentence in fault(partial(certs.folder.issue, folder, name, role, hosts=hosts))


# --- the commands


def test_the_commands_from_init_to_list_and_each_fault_in_one_line(tmp_path: Path) -> None:
    directory, bundle = str(tmp_path / "D"), str(tmp_path / "alice.zip")

    def run(*arguments: str, where: str = directory) -> Ended:
        return run_here("certs", *arguments, "--dir", where)

    init = ("init", "--host", "robot.local", "--host", "192.0.2.7")
    assert run(*init).returncode == 0
    issued = run("issue", "alice", "--role", "operator", "--bundle", bundle, "--days", "90")
    assert (issued.returncode, "alice.json5" in issued.stdout, bundle in issued.stdout) == (0, True, True)
    rows = [re.split("  +", line) for line in run("list").stdout.splitlines()]
    assert rows[0] == ["NAME", "ROLE", "EXPIRES", "COMMON NAME", "STATE"]
    assert [row[1] for row in rows[1:]] == ["ca", "gateway", "operator"]
    expires = f"{dt.datetime.now(dt.UTC) + 90 * DAY:%Y-%m-%d}"
    assert rows[2][2] == f"{dt.datetime.now(dt.UTC) + 730 * DAY:%Y-%m-%d}"
    assert rows[3] == ["alice", "operator", expires, "operator-00", "good"]
    listed = json.loads(run("list", "--json").stdout)
    assert [list(each.values()) for each in listed] == rows[1:]
    assert listed[2]["common_name"] == "operator-00"
    web = run("issue", "web", "--role", "console", "--host", "robot.local")
    assert (web.returncode, "--cert web.pem --key web.key" in web.stdout) == (0, True)
    assert run("renew", "alice").returncode == 0
    nowhere = run("list", where=str(tmp_path / "nowhere"))
    for wrong in (run(*init), run("issue", "../alice", "--role", "operator"), nowhere):
        assert (wrong.returncode, len(wrong.stderr.splitlines())) == (2, 1)


# ---- for browsers


WEB_HOSTS: Final = ("robot.local", "192.0.2.7")


@pytest.mark.parametrize("hosts", [WEB_HOSTS, ("robot.local",), ("192.0.2.7",), ("2001:db8::7",)])
@pytest.mark.parametrize("other", ["bank.example", "local", "192.0.2.8", "10.0.0.1", "2001:db8::8", *WEB_HOSTS])
def test_what_people_import_into_a_browser_is_good_for_the_console_only(
    folder: Path, hosts: Sequence[str], other: str
) -> None:
    """With a stolen key, no other site can be impersonated; judged by OpenSSL, in a real handshake."""
    certs.folder.issue(folder, "web", "console", hosts=hosts)
    ca = load_ca(folder, "web-ca")
    for host in hosts:
        assert trusted(folder / "web-ca.pem", folder / "web.pem", folder / "web.key", host)
    stolen = authority.make_leaf(ca, "console", "stolen", [other], 10, dt.datetime.now(dt.UTC))
    (folder / "stolen.pem").write_bytes(stolen.certificate_pem())
    (folder / "stolen.key").write_bytes(stolen.key_pem())
    assert trusted(folder / "web-ca.pem", folder / "stolen.pem", folder / "stolen.key", other) == (other in hosts)


def trusted(authority_file: Path, certificate: Path, key: Path, host: str) -> bool:
    """Return whether a client that trusts that authority takes the certificate for that host."""
    server = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    server.load_cert_chain(certificate, key)
    to_server, to_client = ssl.MemoryBIO(), ssl.MemoryBIO()
    client = ssl.create_default_context(cafile=authority_file)
    ends = [
        client.wrap_bio(to_client, to_server, server_hostname=host),
        server.wrap_bio(to_server, to_client, server_side=True),
    ]
    for _ in range(4):
        for end in ends:
            try:
                end.do_handshake()
            except ssl.SSLWantReadError:
                continue
            except ssl.SSLCertVerificationError:
                return False
    return True


# ---- who is shut out


def issue(directory: Path, *people: str, role: str = "operator") -> list[str]:
    """Issue certificates, and return their common names."""
    for name in people:
        certs.folder.issue(directory, name, role)
    return [certs.folder.describe(directory / f"{name}.pem").common_name for name in people]


# ---- common names


def test_each_laptop_has_a_common_name_of_its_own_until_all_are_taken(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert issue(folder, "anna", "bert") == ["operator-00", "operator-01"]
    assert issue(folder, "otto", role="observer") == ["observer-00"]
    monkeypatch.setattr(access, "MOST", 2)
    assert "all 2 common names of operator" in fault(lambda: certs.folder.issue(folder, "carl", "operator"))
    assert not (folder / "carl.pem").exists()


# ---- the list


def test_an_unknown_name_is_not_revoked_and_a_revoked_certificate_is_not_renewed(folder: Path) -> None:
    issue(folder, "anna")
    before, pem = contents(folder), (folder / "anna.pem").read_bytes()
    for name in ("nobody", "gateway", "ca", ""):
        assert "no laptop" in fault(partial(certs.folder.revoke, folder, name))
    assert contents(folder) == {**before, "revoked.lock": b""}
    certs.folder.revoke(folder, "anna")
    assert "revoked already" in fault(lambda: certs.folder.revoke(folder, "operator-00"))
    assert "no laptop" in fault(lambda: certs.folder.revoke(folder, "anna2"))
    (folder / "again.pem").write_bytes(pem)
    assert "is revoked" in fault(lambda: certs.folder.renew(folder, "again"))


def list_of(folder: Path, number: int, *shut_out: str) -> RevocationList:
    entries = [Revoked(name, "x", 7 + place, NOW) for place, name in enumerate(shut_out)]
    return revocation.sign(load_ca(folder), number, entries, NOW)


@pytest.mark.filterwarnings("ignore:.*RFC 5280")
def test_of_a_list_with_one_bit_changed_only_what_the_ca_signed_is_taken(folder: Path) -> None:
    """An operator sends it to the service, which no exception of a parser may end."""
    cas, made = certs.files.read_certificates(folder / "ca.pem"), list_of(folder, 5, "operator-00")
    assert revocation.parse(made.pem, cas) == made
    for changed in with_one_bit_changed(made.pem):
        with suppress(ConfigError):
            assert revocation.parse(changed, cas)._replace(pem=made.pem) == made


def test_two_folders_that_each_revoked_somebody_are_merged(folder: Path) -> None:
    """A copy of the folder on another machine: both lists have the number 1."""
    issue(folder, "anna", "bert")
    copy = folder.with_name("copy")
    shutil.copytree(folder, copy)
    theirs, ours = certs.folder.revoke(copy, "bert"), certs.folder.revoke(folder, "anna")
    assert "number is 1, and number 1 is in force" in str(revocation.why_not_newer(ours, theirs))
    both = certs.folder.newest(folder, theirs.pem.decode())
    assert (both.number, set(both.common_names)) == (2, {"operator-00", "operator-01"})
    assert {each.common_name: state for each, state in certs.folder.states(folder)}["operator-01"] == "revoked"


def test_no_entry_is_lost_if_two_people_revoke_at_once(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    issue(folder, "anna", "bert")
    second, sign = threading.Thread(target=certs.folder.revoke, args=(folder, "bert")), revocation.sign

    def sign_later(*args: Any) -> RevocationList:
        if second.ident is None:
            second.start()
            second.join(0.2)  # it waits for the first
        return sign(*args)

    monkeypatch.setattr(revocation, "sign", sign_later)
    certs.folder.revoke(folder, "anna")
    second.join()
    found = certs.folder.revoked(folder)
    assert found is not None
    assert (found.number, sorted(found.common_names)) == (2, ["operator-00", "operator-01"])


# ---- on the robot


def robot(directory: Path) -> Settings:
    return Settings(zenoh=ZenohSettings(config=str(directory / "gateway.json5")))


def test_rules_list_each_roles_common_names_but_for_revoked_ones(folder: Path) -> None:
    issue(folder, "anna")
    known = certs.folder.revoke(folder, "anna")
    config = load_config(folder / "gateway.json5")

    def listed(known: RevocationList | None) -> dict[str, list[str]]:
        if known is not None:
            revocations.list_common_names(config, known.common_names)
        return {each["id"]: each["cert_common_names"] for each in get(config, "access_control/subjects")}

    assert listed(None) == {"operator": ["operator"], "observer": ["observer"], "button": ["button"]}
    but_for_anna = listed(known)
    assert but_for_anna["operator"] == [f"operator-{number:02}" for number in range(1, 1000)]
    assert but_for_anna["observer"] == access.every("observer")
    nobody = listed(list_of(folder, 9, *but_for_anna["observer"]))
    assert nobody["observer"] == [access.NOBODY], "Zenoh takes a subject without names as everyone"


@pytest.mark.virtual_time
async def test_a_list_that_was_kept_counts_before_the_service_has_ended(folder: Path) -> None:
    """Otherwise an older list that comes meanwhile would replace it on the disk."""
    conductor = HarnessedRobot().conductor
    in_force = revocations.revocation_state(load_config(folder / "gateway.json5"), robot(folder))
    changes = revocations.Revocations(conductor, in_force, lambda: None)
    answers: SimpleQueue[bytes] = SimpleQueue()
    for number, accepted in ((6, True), (5, False), (7, True)):
        changes.change(list_of(folder, number), answers.put)
        assert RevocationAck.model_validate_json(answers.get(timeout=10)).accepted is accepted
    kept = revocations.revocation_state(load_config(folder / "gateway.json5"), robot(folder))
    assert kept.known is not None
    assert kept.known.number == 7


def test_a_list_that_cannot_be_read_lets_nobody_in_and_one_of_another_ca_concerns_nobody(folder: Path) -> None:
    config = load_config(folder / "gateway.json5")
    (folder / "revoked.crl").write_bytes(list_of(folder, 3).pem[:-40])
    assert "revoked.crl" in fault(lambda: revocations.revocation_state(config, robot(folder)))
    (folder / "revoked.crl").write_bytes(revocation.sign(OTHER_CA, 6, [], NOW).pem)
    kept = revocations.revocation_state(config, robot(folder))
    assert kept.known is None


def test_a_list_that_cannot_be_written_leaves_the_earlier_one(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="the earlier list stays in force"):
        revocations.keep(tmp_path / "nowhere" / "revoked.crl", list_of(folder, 3))


# ---- when something is wrong: nothing overwritten, nothing half made, one sentence for each fault


def test_an_existing_ca_is_never_replaced(folder: Path) -> None:
    before = contents(folder)
    assert "has a CA already" in fault(lambda: certs.folder.init(folder, HOSTS))
    assert contents(folder) == before
    (folder / "ca.key").unlink()  # kept elsewhere
    assert "has a CA already" in fault(lambda: certs.folder.init(folder, HOSTS))


def test_issue_removes_its_files_if_the_bundle_cannot_be_made(folder: Path, tmp_path: Path) -> None:
    before = contents(folder)
    (tmp_path / "there.zip").write_text("mine")
    (tmp_path / "file").write_text("")
    for bundle in (tmp_path / "there.zip", tmp_path / "file" / "x.zip", folder / "alice.key"):
        fault(partial(certs.folder.issue, folder, "alice", "operator", bundle=bundle))
        assert contents(folder) == before
    assert names(tmp_path) == {"D", "there.zip", "file"}
    assert (tmp_path / "there.zip").read_text() == "mine"


def test_an_interruption_leaves_no_trace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(*_arguments: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(durable, "sync", interrupt)
    with pytest.raises(KeyboardInterrupt):
        certs.folder.init(tmp_path / "D", HOSTS)
    assert names(tmp_path) == set()


def test_a_file_system_without_modes_is_rejected(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "fchmod", lambda _descriptor, _mode: None)
    assert "cannot keep a file private" in fault(lambda: publish({tmp_path / "x.pem": b""}))
    assert names(tmp_path) == set()


# --- bad input: one line that says what to do


NO_HOSTS = ("", "robot.local:7447", "tls/robot.local", "192.0.2.999", "0.0.0.0", "::", "fe80::1%wlan0")  # noqa: S104
NO_NAMES = ("-a.local", "a..b", "*.local", "a_b", "rob ot", '"],evil:["', "x" * 64 + ".local", "*/\n")


@pytest.mark.parametrize(
    ("hosts", "sentence"),
    [
        *(([each], "neither a host name nor an IP address") for each in (*NO_HOSTS, *NO_NAMES)),
        ([], "at least one host"),
        (["robot.local", "::1"], "Zenoh dials no IPv6 address over TLS"),
        (["robot.local", "[2001:DB8::7]"], "Zenoh dials no IPv6 address over TLS"),
    ],
)
def test_invalid_hosts_are_rejected(tmp_path: Path, hosts: list[str], sentence: str) -> None:
    assert sentence in fault(lambda: certs.folder.init(tmp_path / "D", hosts))
    assert names(tmp_path) == set()


def test_a_folder_without_a_ca_is_named(tmp_path: Path) -> None:
    for directory in (tmp_path, tmp_path / "missing"):
        assert "cannot read the key" in fault(partial(issue, directory, "alice"))
    assert "cannot read" in fault(lambda: certs.folder.expiries(tmp_path / "missing"))
    assert "has no certificates" in fault(lambda: certs.folder.expiries(tmp_path))
    (tmp_path / "ca.key").mkdir()
    assert "is not a file" in fault(partial(issue, tmp_path, "alice"))


OTHER_CA: Final = authority.make_ca(NOW)
EVE: Final = authority.make_leaf(OTHER_CA, "operator-00", "eve", (), 30, NOW)


@pytest.mark.parametrize(
    ("file", "content", "call", "sentence"),
    [
        ("ca.key", b"nonsense", issue, "holds no unencrypted key"),
        ("ca.key", OTHER_CA.key_pem(), issue, "do not belong together"),
        ("ca.pem", b"nonsense", issue, "holds no certificate"),
        ("alice.pem", b"nonsense", lambda folder, _: certs.folder.expiries(folder), "holds no certificate"),
        ("gateway.json5", b"{ nonsense", issue, "gateway.json5"),
        ("gateway.json5", b'{listen: {endpoints: ["tcp/[::]:7447"]}}', issue, "listens on no tls endpoint"),
        ("alice.pem", EVE.certificate_pem(), certs.folder.renew, "was not issued by the CA"),
        ("alice.key", EVE.key_pem(), certs.folder.renew, "cannot read the certificate"),
    ],
)
def test_a_file_that_is_broken_or_anothers_is_one_sentence(
    folder: Path, file: str, content: bytes, call: Callable[[Path, str], object], sentence: str
) -> None:
    (folder / file).write_bytes(content)
    before = contents(folder)
    assert sentence in fault(partial(call, folder, "alice"))
    assert contents(folder) == before


def test_an_expired_ca_issues_and_renews_nothing(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert "cannot be a name here" in fault(lambda: certs.folder.renew(folder, "ca"))
    monkeypatch.setattr(certs.folder, "now_utc", lambda: NOW + 3651 * DAY)
    assert "expired" in fault(partial(issue, folder, "alice"))
    assert "expired" in fault(lambda: certs.folder.renew(folder, "gateway"))


def test_faults_in_zenoh_files_are_named(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    certs.folder.issue(folder, "alice", "operator")
    with monkeypatch.context() as patch:
        patch.setattr(certs.folder, "now_utc", lambda: NOW - 10 * DAY)
        certs.folder.issue(folder, "old", "operator", days=1)
    config = folder / "alice.json5"
    good = config.read_text()
    assert client_config(None, config)
    assert "cannot read" in fault(lambda: client_config(None, folder / "missing.json5"))
    assert "gateway's own" in fault(lambda: client_config(None, folder / "gateway.json5"))
    assert f"expired on {NOW - 9 * DAY:%Y-%m-%d}" in fault(lambda: client_config(None, folder / "old.json5"))
    for good_part, bad_part, sentence in (
        ("scouting", "scooting", "scooting"),
        ('"alice.key"', '"nowhere.key"', "nowhere.key"),
        ('"alice.pem"', '"alice.key"', "holds no certificate"),
    ):
        config.write_text(good.replace(good_part, bad_part))
        assert sentence in fault(lambda: client_config(None, config))
