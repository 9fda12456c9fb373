"""A folder of a fleet: certificates for several robots, and what the router lists of them."""

import zipfile
from pathlib import Path

import pytest
import zenoh

from gateway import certs
from gateway.certs import pool
from gateway.certs.proof import ProofChecker
from gateway.people.client.requests import Identity
from gateway.zenoh_config import get
from schemas.lease import Proof
from tests.support.certs_folder import DAY, NOW, fault
from tests.support.command import run_here

ROBOTS = ["robot-1", "robot-2", "robot-3"]


@pytest.fixture(name="fleet")
def make_fleet(tmp_path: Path) -> Path:
    """Three robots, and a pool of three common names."""
    certs.folder.init(tmp_path / "D", ["router.local"], size=3, now=NOW)
    certs.folder.add_robots(tmp_path / "D", ROBOTS, now=NOW)
    return tmp_path / "D"


def issue(directory: Path, name: str, *robots: str) -> str:
    """The common name that it gets."""
    certs.folder.issue(directory, name, "operator", robots=robots, now=NOW)
    return certs.folder.describe(directory / f"{name}.pem").common_name


def robots_that_list(directory: Path, common_name: str, file: str = "router.json5") -> set[str]:
    """Whose rules the router applies to this common name."""
    subjects = get(zenoh.Config.from_file(str(directory / file)), "access_control/subjects")
    return {each["id"].partition(".")[2] for each in subjects if common_name in each["cert_common_names"]}


@pytest.mark.parametrize(
    ("robots", "common_name", "listed"),
    [
        (["robot-2"], "operator-00.robot-2", {"robot-2"}),
        (["robot-3", "robot-1", "robot-3"], "operator-00.robot-1.robot-3", {"robot-1", "robot-3"}),
        ([pool.ALL], "operator-00.robots.all", {*ROBOTS}),
    ],
)
def test_a_certificate_is_good_for_its_robots_and_for_no_other(
    fleet: Path, robots: list[str], common_name: str, listed: set[str]
) -> None:
    """At the router, and for the lease, of which each robot judges itself."""
    assert issue(fleet, "anna", *robots) == common_name
    assert robots_that_list(fleet, common_name) == listed
    assert robots_that_list(fleet, common_name, "gateway.json5") == set(), "a single robot's rules"
    identity = Identity(fleet / "anna.pem", fleet / "anna.key")
    proof = Proof.model_validate(identity.prove("acquire", "anna", "0" * 32))
    for robot in (*ROBOTS, ""):
        own = fleet / f"{robot or 'gateway'}.pem"
        why_not = ProofChecker.of(fleet / "ca.pem", own).fault(proof, "acquire", "anna", NOW)
        assert (why_not is None) is (robot in listed), why_not


def test_a_robot_that_is_added_is_one_of_all_robots_and_a_new_group_is_told_to_the_router_once(fleet: Path) -> None:
    router = fleet / "router.json5"
    assert router not in certs.folder.issue(fleet, "alma", "operator", robots=[pool.ALL], now=NOW)
    certs.folder.add_robots(fleet, ["robot-4"], now=NOW)
    assert robots_that_list(fleet, "operator-00.robots.all") == {*ROBOTS, "robot-4"}
    assert 'namespace: "robot-4"' in (fleet / "alma.robot-4.json5").read_text()
    assert 'connect_certificate: "alma.pem"' in (fleet / "alma.robot-4.json5").read_text()
    two = ["robot-1", "robot-4"]
    assert router in certs.folder.issue(fleet, "bert", "operator", robots=two, now=NOW)
    assert router not in certs.folder.issue(fleet, "carl", "operator", robots=two, now=NOW)
    assert robots_that_list(fleet, "operator-01.robot-1.robot-4") == {*two}


def test_a_bundle_for_several_robots_has_a_file_for_each(fleet: Path, tmp_path: Path) -> None:
    bundle = tmp_path / "anna.zip"
    said = run_here(
        "certs", "issue", "anna", "--role", "operator", "--robot", "robot-2", "--robot", "robot-1", "--dir", str(fleet),
        "--bundle", str(bundle),
    )  # fmt: skip
    assert said.returncode == 0, said.stderr
    assert "operator of robot-2, robot-1 (operator-00.robot-1.robot-2)" in said.stdout
    assert "The router has to know" in said.stdout
    with zipfile.ZipFile(bundle) as archive:
        configs = ["anna.robot-1.json5", "anna.robot-2.json5"]
        assert sorted(archive.namelist()) == ["README.txt", "anna.key", "anna.pem", *configs, "ca.pem"]
        assert b"Each robot has a file of its own: anna.robot-1.json5, anna.robot-2.json5." in archive.read(
            "README.txt"
        )
        for robot, config in zip(ROBOTS, configs, strict=False):
            assert f'namespace: "{robot}"'.encode() in archive.read(config)


def test_who_has_several_robots_is_revoked_and_reissued_with_all_files(fleet: Path) -> None:
    assert issue(fleet, "anna", "robot-1", "robot-2") == "operator-00.robot-1.robot-2"
    certs.moving.reissue(fleet, "anna", now=NOW)
    assert robots_that_list(fleet, "operator-00.robot-1.robot-2") == {"robot-1", "robot-2"}, "still good"
    assert robots_that_list(fleet, "operator-01.robot-1.robot-2") == {"robot-1", "robot-2"}
    certs.moving.revoke(fleet, "anna", now=NOW)
    for number in range(2):
        assert robots_that_list(fleet, f"operator-0{number}.robot-1.robot-2") == set()
    assert not list(fleet.glob("anna*"))
    assert issue(fleet, "anna", pool.ALL) == "operator-00.robots.all"


def test_which_robots_there_may_be(fleet: Path, tmp_path: Path) -> None:
    certs.folder.init(tmp_path / "one", ["robot.local"], now=NOW)
    assert "has no robots" in fault(lambda: issue(tmp_path / "one", "anna", pool.ALL))
    assert "has no robot 'robot-9'" in fault(lambda: issue(fleet, "anna", "robot-1", "robot-9"))
    long = [f"robot-{'x' * 20}-{number}" for number in range(2)]
    certs.folder.add_robots(fleet, long, now=NOW)
    assert "too long together" in fault(lambda: issue(fleet, "anna", *long))
    both = ("--robot", "robot-1", "--all-robots")
    assert run_here("certs", "issue", "anna", "--role", "operator", "--dir", str(fleet), *both).returncode == 2
    assert not list(fleet.glob("anna*"))


def test_without_an_operator_who_stays_a_list_is_signed_and_named_as_not_confirmed(fleet: Path) -> None:
    """The one who is revoked brings it nowhere, nor does one of another robot, or one whose certificate has expired."""
    for name, days, robots in (("anna", 9, [pool.ALL]), ("bert", 1, ["robot-1", "robot-2"])):
        certs.folder.issue(fleet, name, "operator", robots=robots, days=days, now=NOW - 5 * DAY)
    ended = run_here("certs", "revoke", "anna", "--dir", str(fleet))
    assert ended.returncode == 1
    assert "list 1 shuts out operator-00.robots.all" in ended.stdout
    for robot in ROBOTS:
        assert f"\n{robot}: {fleet} has no files of an operator of it" in f"\n{ended.stderr}"
    assert "Not confirmed by robot-1, robot-2, robot-3." in ended.stderr
    assert certs.confirmed.shown(fleet) == dict.fromkeys(ROBOTS, "not 1")


def test_a_record_of_who_has_confirmed_that_cannot_be_read_is_named(fleet: Path) -> None:
    certs.moving.revoke(fleet, "operator-40.robot-1", now=NOW)
    certs.confirmed.note(fleet, "robot-2", 1)
    certs.moving.revoke(fleet, "operator-41.robot-1", now=NOW)
    certs.confirmed.note(fleet, "robot-1", 2)
    assert certs.confirmed.shown(fleet) == {"robot-1": "2", "robot-2": "1, not 2", "robot-3": "not 2"}
    for text in ("", "[]", '{"robot-1": -1}'):
        (fleet / "confirmed.json").write_text(text)
        assert "confirmed.json cannot be read: delete it" in fault(lambda: certs.confirmed.numbers(fleet))
