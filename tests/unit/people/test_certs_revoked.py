"""Who is shut out, who gets another certificate, and another CA: what a folder of certificates is then."""

import asyncio
import datetime as dt
import re
import shutil
import zipfile
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from queue import SimpleQueue

import pytest
import zenoh

from gateway import certs
from gateway.certs import authority, moving, pool, revocation
from gateway.certs.folder import load_ca
from gateway.certs.revocation import RevocationList, Revoked
from gateway.errors import ConfigError
from gateway.robot.runtime.revocations import Revocations
from gateway.robot.sections import ZenohSettings
from gateway.robot.zenoh_io import revoked
from gateway.zenoh_config import get, load_config
from schemas.revocation import RevocationAck
from tests.support.certs_folder import NOW, contents, fault, make_folder, mode, with_one_bit_changed
from tests.support.robot import Robot as HarnessedRobot

__all__ = ["make_folder"]  # a fixture

TODAY = Path(__file__).parents[2] / "data" / "certs" / "1.1"
"""A folder as release 1.1 made it: all operators have the common name `operator`."""


def common_name(directory: Path, name: str) -> str:
    return certs.folder.describe(directory / f"{name}.pem").common_name


def issue(directory: Path, *names: str, role: str = "operator") -> list[str]:
    """The common names that they get."""
    for name in names:
        certs.folder.issue(directory, name, role, now=NOW)
    return [common_name(directory, name) for name in names]


def operators(directory: Path) -> list[str]:
    subjects = get(zenoh.Config.from_file(str(directory / "gateway.json5")), "access_control/subjects")
    return next(each["cert_common_names"] for each in subjects if each["id"] == "operator")


def states(directory: Path) -> dict[str, str]:
    return {each.common_name: state for each, state in certs.moving.states(directory, NOW)}


# ---- the pool


@pytest.mark.parametrize(
    ("text", "holder"),
    [
        ("operator", ("operator", None, "")),
        ("operator-07", ("operator", 7, "")),
        ("observer-163", ("observer", 163, "")),
        ("operator.robot-1", ("operator", None, "robot-1")),
        ("operator-07.robot-1", ("operator", 7, "robot-1")),
        ("operator-07.robot-1.x", ("operator", 7, "robot-1.x")),
        ("operator-7", ("operator-7", None, "")),
        ("Operator-07", ("Operator-07", None, "")),
        ("operator-07 ", ("operator-07 ", None, "")),
        ("gateway", ("gateway", None, "")),
        ("robot.robot-1", ("robot.robot-1", None, "")),
        ("admin-07", ("admin-07", None, "")),
        ("", ("", None, "")),
    ],
)
def test_what_a_common_name_says(text: str, holder: tuple[str, int | None, str]) -> None:
    assert pool.holder(text) == holder


def test_each_laptop_has_a_common_name_that_the_rules_list(folder: Path) -> None:
    assert issue(folder, "anna", "bert") == ["operator-00", "operator-01"]
    assert issue(folder, "otto", role="observer") == ["observer-00"]
    assert operators(folder) == ["operator", *(f"operator-{number:02}" for number in range(64))]


def test_a_larger_pool_and_one_that_is_used_up(tmp_path: Path) -> None:
    certs.folder.init(tmp_path / "D", ["robot.local"], size=2, now=NOW)
    assert issue(tmp_path / "D", "anna", "bert") == ["operator-00", "operator-01"]
    assert "certs pool --size 66" in fault(lambda: certs.folder.issue(tmp_path / "D", "carl", "operator", now=NOW))
    assert not (tmp_path / "D" / "carl.pem").exists()
    certs.moving.set_pool(tmp_path / "D", 200)
    assert issue(tmp_path / "D", "carl") == ["operator-02"]
    assert len(operators(tmp_path / "D")) == 201
    assert "1000 at most" in fault(lambda: certs.moving.set_pool(tmp_path / "D", 1001))
    certs.moving.set_pool(tmp_path / "D", 3)
    assert len(operators(tmp_path / "D")) == 201


# ---- the list


def test_a_revoked_name_is_on_the_list_and_its_common_name_is_never_given_again(folder: Path) -> None:
    issue(folder, "anna", "bert")
    key = (folder / "anna.key").read_bytes()
    made = certs.moving.revoke(folder, "anna", now=NOW)
    (kept,) = (folder / "earlier").glob("anna-*.key")
    assert (kept.read_bytes(), mode(kept), mode(kept.parent)) == (key, 0o600, 0o700)
    assert (made.number, set(made.common_names)) == (1, {"operator-00"})
    assert revocation.read(folder / "revoked.crl", certs.files.read_certificates(folder / "ca.pem")) == made
    assert issue(folder, "anna") == ["operator-02"]
    assert states(folder) == {
        "ca": "good", "gateway": "good", "operator-00": "revoked", "operator-01": "good", "operator-02": "good",
    }  # fmt: skip


def test_all_that_a_lost_laptop_ever_had_is_shut_out_and_one_common_name_alone_if_so_named(folder: Path) -> None:
    issue(folder, "anna")
    certs.moving.reissue(folder, "anna", now=NOW)
    assert states(folder)["operator-00"] == "replaced"
    copy = folder.with_name("copy")
    shutil.copytree(folder, copy)
    assert certs.moving.revoke(folder, "anna", now=NOW).common_names == {"operator-00", "operator-01"}
    assert certs.moving.revoke(copy, "operator-00", now=NOW).common_names == {"operator-00"}
    assert states(copy)["operator-01"] == "good"
    assert certs.moving.revoke(copy, "operator-40", now=NOW).common_names == {"operator-00", "operator-40"}
    assert states(copy)["operator-40"] == "revoked"


def test_who_cannot_be_revoked(folder: Path) -> None:
    issue(folder, "anna")
    before = contents(folder)
    for name in ("nobody", "gateway", "ca", ""):
        assert "no laptop" in fault(partial(certs.moving.revoke, folder, name, now=NOW))
    assert contents(folder) == before
    certs.moving.revoke(folder, "anna", now=NOW)
    assert "revoked already" in fault(lambda: certs.moving.revoke(folder, "operator-00", now=NOW))
    assert "no laptop" in fault(lambda: certs.moving.revoke(folder, "anna2", now=NOW))


def test_a_revoked_certificate_is_not_renewed(folder: Path) -> None:
    issue(folder, "anna")
    (folder / "copy.pem").write_bytes((folder / "anna.pem").read_bytes())
    certs.moving.revoke(folder, "anna", others_too=True, now=NOW)
    (folder / "copy.pem").write_bytes(next((folder / "earlier").glob("anna-*.pem")).read_bytes())
    assert "is revoked" in fault(lambda: certs.folder.renew(folder, "copy", now=NOW))


def list_of(folder: Path, number: int, *names: str) -> RevocationList:
    entries = [Revoked(name, "x", 7 + place, NOW) for place, name in enumerate(names)]
    return revocation.sign(load_ca(folder, NOW), number, entries, NOW)


def test_a_list_comes_back_as_it_was_signed_and_a_changed_one_does_not(folder: Path) -> None:
    cas = certs.files.read_certificates(folder / "ca.pem")
    made = list_of(folder, 5, "operator-00", "operator-07.robot-1")
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
    theirs, ours = certs.moving.revoke(copy, "bert", now=NOW), certs.moving.revoke(folder, "anna", now=NOW)
    assert revocation.why_not_newer(ours, theirs) is not None
    both = moving.merge(folder, theirs, now=NOW)
    assert (both.number, set(both.common_names)) == (2, {"operator-00", "operator-01"})
    assert states(folder)["operator-01"] == "revoked"


# ---- on the robot


def robot(directory: Path) -> ZenohSettings:
    return ZenohSettings(config=str(directory / "gateway.json5"))


def test_the_rules_list_nobody_who_is_revoked_and_a_role_without_anybody_stays_a_role(folder: Path) -> None:
    issue(folder, "anna")
    certs.moving.revoke(folder, "anna", now=NOW)
    config = load_config(folder / "gateway.json5")
    kept = revoked.revocation_state(config, robot(folder))
    assert kept is not None
    revoked.leave_out(config, kept.known)
    subjects = {each["id"]: each["cert_common_names"] for each in get(config, "access_control/subjects")}
    assert "operator-00" not in subjects["operator"]
    assert len(subjects["operator"]) == 64
    assert len(subjects["observer"]) == 65
    everybody = list_of(folder, 9, *subjects["observer"])
    revoked.leave_out(config, everybody)
    assert get(config, "access_control/subjects")[1]["cert_common_names"] == [pool.NO_COMMON_NAME]


def test_of_two_places_the_newer_list_is_in_force_and_it_is_kept_in_the_services_own(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    state = tmp_path / "state"
    state.mkdir()
    monkeypatch.setenv("STATE_DIRECTORY", str(state))
    config = load_config(folder / "gateway.json5")
    (folder / "revoked.crl").write_bytes(list_of(folder, 3).pem)
    for number, in_force in ((2, 3), (4, 4)):
        revoked.keep(state / "revoked.crl", list_of(folder, number))
        kept = revoked.revocation_state(config, robot(folder))
        assert kept is not None
        assert kept.known is not None
        assert (kept.path, kept.known.number) == (state / "revoked.crl", in_force)


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


def test_an_older_list_that_a_backup_brings_takes_no_effect_and_is_put_right(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where the newest one is gone, or one of another CA lies in its place."""
    state, config = tmp_path / "state", load_config(folder / "gateway.json5")
    state.mkdir()
    monkeypatch.setenv("STATE_DIRECTORY", str(state))
    revoked.keep(state / "revoked.crl", list_of(folder, 3, "operator-00"))
    backup = contents(state)
    newest = list_of(folder, 11, "operator-00", "operator-01")
    revoked.keep(state / "revoked.crl", newest)
    for stale, brought in (
        (3, backup),
        (0, {"revoked.crl": revocation.sign(authority.make_ca(NOW), 20, [], NOW).pem}),
        (0, {}),
    ):
        (state / "revoked.crl").unlink()
        for name, data in brought.items():
            (state / name).write_bytes(data)
        kept = revoked.revocation_state(config, robot(folder))
        assert kept is not None
        assert (kept.known, kept.stale) == (newest, stale)
        revoked.keep(kept.path, newest)
        assert contents(state) == {"revoked.crl": newest.pem, "revoked-11.crl": newest.pem}
        right = revoked.revocation_state(config, robot(folder))
        assert right is not None
        assert (right.known, right.stale) == (newest, None)
    (state / "revoked-11.crl").write_bytes(b"")
    kept = revoked.revocation_state(config, robot(folder))
    assert kept is not None, "what is remembered matters only where it is newer"
    (state / "revoked.crl").unlink()
    assert "revoked-11.crl" in fault(lambda: revoked.revocation_state(config, robot(folder)))


def test_a_disk_that_is_full_leaves_the_list_before(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="the list before stays in force"):
        revoked.keep(tmp_path / "nowhere" / "revoked.crl", list_of(folder, 3))


def test_in_1970_a_list_is_judged_as_ever(folder: Path) -> None:
    """Of the list nothing is judged by the clock: it is signed by a CA that is not valid yet, and does not expire."""
    in_1970 = dt.datetime(1970, 1, 1, tzinfo=dt.UTC)
    made = revocation.sign(load_ca(folder, NOW), 1, [Revoked("operator-00", "anna", 7, in_1970)], in_1970)
    ca = certs.files.read_certificate(folder / "ca.pem")
    assert revocation.parse(made.pem, [ca]).common_names == {"operator-00"}


# ---- the layout before


@pytest.fixture(name="today")
def todays_folder(tmp_path: Path) -> Path:
    return Path(shutil.copytree(TODAY, tmp_path / "today"))


def test_files_of_the_layout_before_go_on_and_one_by_one_they_move(today: Path) -> None:
    assert [common_name(today, name) for name in ("anna", "otto")] == ["operator", "observer"]
    assert issue(today, "bert") == ["operator"]
    assert "certs pool" in fault(lambda: certs.moving.reissue(today, "anna", now=NOW))
    assert "bert have the same common name" in fault(lambda: certs.moving.revoke(today, "anna", now=NOW))
    text = (today / "gateway.json5").read_text()
    certs.moving.set_pool(today)
    changed = (today / "gateway.json5").read_text()
    assert re.sub(r"\[[^\]]*\]", "", changed) == re.sub(r"\[[^\]]*\]", "", text)
    assert len(operators(today)) == 65
    assert operators(today)[0] == "operator"
    certs.moving.reissue(today, "anna", bundle=today / "anna.zip", now=NOW)
    assert common_name(today, "anna") == "operator-00"
    with zipfile.ZipFile(today / "anna.zip") as archive:
        assert sorted(archive.namelist()) == ["README.txt", "anna.json5", "anna.key", "anna.pem", "ca.pem"]
    certs.moving.reissue(today, "bert", now=NOW)
    assert certs.moving.revoke(today, "operator", now=NOW).common_names == {"operator"}
    assert states(today)["operator-01"] == "good"


def test_a_folder_of_before_there_were_buttons_names_the_command_that_makes_its_rules_anew(today: Path) -> None:
    named = fault(lambda: certs.folder.issue(today, "kitchen", "button", now=NOW))
    assert f"certs init --dir $d --host $(hostname) --port 7447 && sudo cp $d/gateway.json5 {today}" in named
    certs.folder.init(today.parent / "new", ["robot"], port=7447, now=NOW)
    shutil.copy(today.parent / "new" / "gateway.json5", today)
    certs.folder.issue(today, "kitchen", "button", now=NOW)
    assert common_name(today, "kitchen") == "button-00"


def test_others_are_shut_out_too_where_that_is_asked_for(today: Path) -> None:
    issue(today, "bert")
    assert certs.moving.revoke(today, "anna", others_too=True, now=NOW).common_names == {"operator"}


def test_a_fleet_moves_with_its_router(tmp_path: Path) -> None:
    directory = tmp_path / "fleet"
    certs.folder.init(directory, ["router.local"], size=3, now=NOW)
    certs.folder.add_robots(directory, ["robot-1", "robot-2"], now=NOW)
    certs.folder.issue(directory, "anna", "operator", robots=["robot-1"], now=NOW)
    certs.folder.issue(directory, "bert", "operator", robots=["robot-2"], now=NOW)
    assert common_name(directory, "anna") == "operator-00.robot-1"
    assert common_name(directory, "bert") == "operator-00.robot-2"

    def listed() -> dict[str, list[str]]:
        subjects = get(zenoh.Config.from_file(str(directory / "router.json5")), "access_control/subjects")
        return {each["id"]: each["cert_common_names"] for each in subjects}

    pool_of_one = ["operator.robot-1", *(f"operator-0{each}.robot-1" for each in range(3))]
    assert [name for name in listed()["operator.robot-1"] if not name.endswith(pool.ALL)] == pool_of_one
    certs.moving.revoke(directory, "anna", now=NOW)
    assert "operator-00.robot-1" not in listed()["operator.robot-1"]
    assert "operator-00.robot-2" in listed()["operator.robot-2"]
    certs.moving.set_pool(directory, 5)
    assert len(listed()["observer.robot-2"]) == 2 * 6, "and those for all robots"


# ---- another CA


def test_another_ca_takes_the_first_ones_place_laptop_by_laptop(folder: Path) -> None:
    issue(folder, "anna", "bert")
    certs.moving.revoke(folder, "bert", now=NOW)
    old = certs.files.read_certificate(folder / "ca.pem")
    certs.moving.replace_ca(folder, now=NOW)
    cas = certs.files.read_certificates(folder / "ca.pem")
    assert cas[1] == old
    assert revocation.read(folder / "revoked.crl", cas[:1]) is not None, "the new CA has signed it"
    assert states(folder)["operator-00"] == states(folder)["gateway"] == "older CA"
    assert issue(folder, "carl") == ["operator-64"]
    assert "certs reissue anna" in fault(lambda: certs.folder.renew(folder, "anna", now=NOW))
    assert "127.0.0.1" not in fault(lambda: certs.moving.drop_ca(folder, now=NOW))
    certs.moving.reissue(folder, "anna", now=NOW)
    assert common_name(folder, "anna") == "operator-65"
    certs.folder.renew(folder, "gateway", now=NOW)
    assert "two CAs already" in fault(lambda: certs.moving.replace_ca(folder, now=NOW))
    certs.moving.drop_ca(folder, now=NOW)
    assert certs.files.read_certificates(folder / "ca.pem") == cas[:1]
    assert {state for _, state in certs.moving.states(folder, NOW)} == {"good", "replaced", "revoked"}
    assert issue(folder, "dora") == ["operator-66"]


def test_a_ca_that_is_replaced_half_way_is_whole(folder: Path) -> None:
    """The new certificate is there, the new key is not: what is issued is the old CA's, and good."""
    (folder / "ca.pem").write_bytes(authority.make_ca(NOW, 64).certificate_pem() + (folder / "ca.pem").read_bytes())
    assert issue(folder, "anna") == ["operator-00"]
    certs.files.read_certificate(folder / "anna.pem").verify_directly_issued_by(
        certs.files.read_certificates(folder / "ca.pem")[1]
    )


def test_a_bundle_has_both_cas_while_there_are_two(folder: Path) -> None:
    certs.moving.replace_ca(folder, now=NOW)
    certs.folder.issue(folder, "anna", "operator", bundle=folder / "anna.zip", now=NOW)
    with zipfile.ZipFile(folder / "anna.zip") as archive:
        assert archive.read("ca.pem") == (folder / "ca.pem").read_bytes()
