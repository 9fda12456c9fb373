"""Who is shut out: the list of a folder of certificates, and what a robot makes of it."""

import asyncio
import shutil
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from queue import SimpleQueue

import pytest

from gateway import certs
from gateway.certs import access, authority, revocation
from gateway.certs.folder import load_ca
from gateway.certs.revocation import RevocationList, Revoked
from gateway.errors import ConfigError
from gateway.host.settings_table import ZenohSettings
from gateway.robot.runtime.revocations import Revocations
from gateway.robot.settings import Settings
from gateway.robot.zenoh_io import revoked
from gateway.zenoh_config import get, load_config
from schemas.revocation import RevocationAck
from tests.support.certs_folder import NOW, contents, fault, make_folder, with_one_bit_changed
from tests.support.robot import Robot as HarnessedRobot

__all__ = ["make_folder"]  # a fixture


def common_name(directory: Path, name: str) -> str:
    return certs.folder.describe(directory / f"{name}.pem").common_name


def issue(directory: Path, *people: str, role: str = "operator") -> list[str]:
    """The common names that they get."""
    for name in people:
        certs.folder.issue(directory, name, role, now=NOW)
    return [common_name(directory, name) for name in people]


def states(directory: Path) -> dict[str, str]:
    return {each.common_name: state for each, state in certs.folder.states(directory, NOW)}


# ---- common names


def test_each_laptop_has_a_common_name_of_its_own_until_all_are_taken(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert issue(folder, "anna", "bert") == ["operator-00", "operator-01"]
    assert issue(folder, "otto", role="observer") == ["observer-00"]
    monkeypatch.setattr(access, "MOST", 2)
    assert "all 2 common names of operator" in fault(lambda: certs.folder.issue(folder, "carl", "operator", now=NOW))
    assert not (folder / "carl.pem").exists()


# ---- the list


def test_who_cannot_be_revoked(folder: Path) -> None:
    issue(folder, "anna")
    before = contents(folder)
    for name in ("nobody", "gateway", "ca", ""):
        assert "no laptop" in fault(partial(certs.folder.revoke, folder, name, now=NOW))
    assert contents(folder) == before
    certs.folder.revoke(folder, "anna", now=NOW)
    assert "revoked already" in fault(lambda: certs.folder.revoke(folder, "operator-00", now=NOW))
    assert "no laptop" in fault(lambda: certs.folder.revoke(folder, "anna2", now=NOW))


def test_a_revoked_certificate_is_not_renewed(folder: Path) -> None:
    issue(folder, "anna")
    pem = (folder / "anna.pem").read_bytes()
    certs.folder.revoke(folder, "operator-00", now=NOW)
    (folder / "again.pem").write_bytes(pem)
    assert "is revoked" in fault(lambda: certs.folder.renew(folder, "again", now=NOW))


def list_of(folder: Path, number: int, *shut_out: str) -> RevocationList:
    entries = [Revoked(name, "x", 7 + place, NOW) for place, name in enumerate(shut_out)]
    return revocation.sign(load_ca(folder, NOW), number, entries, NOW)


def test_a_list_comes_back_as_it_was_signed_and_a_changed_one_does_not(folder: Path) -> None:
    cas = certs.files.read_certificates(folder / "ca.pem")
    made = list_of(folder, 5, "operator-00", "operator-07")
    assert revocation.parse(made.pem, cas) == made
    for text in (b"", b"no list", made.pem[:200], (folder / "ca.pem").read_bytes()):
        with pytest.raises(ConfigError, match="no list of"):
            revocation.parse(text, cas)
    other = authority.make_ca(NOW)
    with pytest.raises(revocation.ForeignListError, match="not signed by a CA of this robot"):
        revocation.parse(revocation.sign(other, 6, made.entries, NOW).pem, cas)


@pytest.mark.filterwarnings("ignore:.*RFC 5280")
def test_of_a_list_with_one_bit_changed_only_what_the_ca_signed_is_taken(folder: Path) -> None:
    """An operator sends it to the service, which no exception of a parser may end."""
    cas, made = certs.files.read_certificates(folder / "ca.pem"), list_of(folder, 5, "operator-00")
    for changed in with_one_bit_changed(made.pem):
        with suppress(ConfigError):
            assert replace(revocation.parse(changed, cas), pem=made.pem) == made


def test_only_a_higher_number_takes_its_place(folder: Path) -> None:
    five, six, other_five = list_of(folder, 5), list_of(folder, 6), list_of(folder, 5, "operator-00")
    assert revocation.why_not_newer(five, None) is None
    assert revocation.why_not_newer(six, five) is None
    assert "number is 5, and number 6 is in force" in str(revocation.why_not_newer(five, six))
    assert "another list with the number 5" in str(revocation.why_not_newer(other_five, five))


def test_two_folders_that_each_revoked_somebody_are_merged(folder: Path) -> None:
    """A copy of the folder on another machine: both lists have the number 1."""
    issue(folder, "anna", "bert")
    copy = folder.with_name("copy")
    shutil.copytree(folder, copy)
    theirs, ours = certs.folder.revoke(copy, "bert", now=NOW), certs.folder.revoke(folder, "anna", now=NOW)
    assert revocation.why_not_newer(ours, theirs) is not None
    both = certs.folder.newest(folder, theirs.pem.decode(), now=NOW)
    assert (both.number, set(both.common_names)) == (2, {"operator-00", "operator-01"})
    assert states(folder)["operator-01"] == "revoked"


# ---- on the robot


def robot(directory: Path) -> Settings:
    return Settings(zenoh=ZenohSettings(config=str(directory / "gateway.json5")))


def test_rules_list_each_roles_common_names_but_for_revoked_ones(folder: Path) -> None:
    issue(folder, "anna")
    known = certs.folder.revoke(folder, "anna", now=NOW)
    config = load_config(folder / "gateway.json5")
    written = {each["id"]: each["cert_common_names"] for each in get(config, "access_control/subjects")}
    assert written == {"operator": ["operator"], "observer": ["observer"], "button": ["button"]}
    revoked.list_common_names(config, known)
    listed = {each["id"]: each["cert_common_names"] for each in get(config, "access_control/subjects")}
    assert listed["operator"] == [f"operator-{number:02}" for number in range(1, 1000)]
    assert listed["observer"] == access.every("observer")
    revoked.list_common_names(config, list_of(folder, 9, *listed["observer"]))
    nobody = {each["id"]: each["cert_common_names"] for each in get(config, "access_control/subjects")}
    assert nobody["observer"] == [access.NOBODY], "Zenoh takes a subject without names as everyone"


@pytest.mark.virtual_time
async def test_a_list_that_was_kept_counts_before_the_service_has_ended(folder: Path) -> None:
    """Else an older one that comes meanwhile would take its place on the disk."""
    conductor = HarnessedRobot().conductor
    loop, in_force = (
        asyncio.get_running_loop(),
        revoked.revocation_state(load_config(folder / "gateway.json5"), robot(folder)),
    )
    changes = Revocations(conductor, in_force, loop, lambda: None)
    answers: SimpleQueue[bytes] = SimpleQueue()
    for number, accepted in ((6, True), (5, False)):
        changes.change(list_of(folder, number), answers.put)
        assert RevocationAck.model_validate_json(answers.get(timeout=10)).accepted is accepted
    kept = revoked.revocation_state(load_config(folder / "gateway.json5"), robot(folder))
    assert kept is not None
    assert kept.known is not None
    assert kept.known.number == 6


def test_a_list_that_cannot_be_read_lets_nobody_in_and_one_of_another_ca_concerns_nobody(folder: Path) -> None:
    config = load_config(folder / "gateway.json5")
    (folder / "revoked.crl").write_bytes(list_of(folder, 3).pem[:-40])
    assert "revoked.crl" in fault(lambda: revoked.revocation_state(config, robot(folder)))
    (folder / "revoked.crl").write_bytes(revocation.sign(authority.make_ca(NOW), 6, [], NOW).pem)
    kept = revoked.revocation_state(config, robot(folder))
    assert kept is not None
    assert kept.known is None


def test_a_disk_that_is_full_leaves_the_list_before(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="the list before stays in force"):
        revoked.keep(tmp_path / "nowhere" / "revoked.crl", list_of(folder, 3))
