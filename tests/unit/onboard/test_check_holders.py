"""What `check` says of the laptops' common names, and of two CAs."""

import shutil
from pathlib import Path

import pytest

from gateway import certs
from gateway.onboard.check import holders
from gateway.onboard.check.result import Result, Verdict
from gateway.people.client.requests import Identity
from gateway.robot.sections import ZenohSettings
from gateway.robot.zenoh_io import revoked
from gateway.robot.zenoh_io.revoked import OlderCa
from gateway.zenoh_config import load_config
from schemas.telemetry import RevocationsReport
from tests.support.certs_folder import NOW, make_folder
from tests.unit.people.test_certs_revoked import TODAY

__all__ = ["make_folder"]  # a fixture


def robot(directory: Path) -> list[Result]:
    file = directory / "gateway.json5"
    return list(holders.at_the_robot(load_config(file), str(file)))


def laptop(directory: Path, name: str) -> list[Result]:
    return list(holders.on_the_laptop(Identity(directory / f"{name}.pem", ca=directory / "ca.pem")))


def test_the_layout_before_is_named_with_the_command_that_moves_it(tmp_path: Path) -> None:
    today = Path(shutil.copytree(TODAY, tmp_path / "today"))
    (found,) = robot(today)
    assert found.verdict is Verdict.WARNING
    assert f"certs pool --dir {today} " in found.fix
    (own,) = laptop(today, "anna")
    assert "common name operator," in own.sentence
    assert "certs reissue anna" in own.fix
    certs.moving.set_pool(today)
    assert robot(today) == []
    certs.moving.reissue(today, "anna")
    assert laptop(today, "anna") == []


def test_a_new_folder_has_nothing_to_be_said_of(folder: Path) -> None:
    certs.folder.issue(folder, "anna", "operator", now=NOW)
    assert robot(folder) == laptop(folder, "anna") == laptop(folder, "gateway") == []


def test_who_still_comes_with_the_older_ca_is_counted(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("RUNTIME_DIRECTORY", str(tmp_path))
    certs.folder.issue(folder, "anna", "operator", now=NOW)
    certs.moving.replace_ca(folder, now=NOW)
    certs.folder.issue(folder, "bert", "operator", now=NOW)
    (nobody_noted,) = robot(folder)
    assert "nobody has noted" in nobody_noted.sentence
    settings = ZenohSettings(config=str(folder / "gateway.json5"))
    counted: list[int] = []
    older = OlderCa(revoked.revocation_state(load_config(folder / "gateway.json5"), settings), counted.append)
    (none_yet,) = robot(folder)
    assert none_yet.verdict is Verdict.OK
    for connected in ({"operator-64"}, {"operator-00", "operator-64", "gateway"}, {"operator-00"}, {"operator"}):
        older.note(connected)
    assert counted == [1, 2]
    (still,) = robot(folder)
    assert still.verdict is Verdict.WARNING
    assert still.sentence.startswith("2 came ")
    assert still.sentence.endswith(": operator, operator-00")
    (own,) = laptop(folder, "anna")
    assert "older of two CAs" in own.sentence
    assert laptop(folder, "bert") == []


def test_with_one_ca_nobody_is_counted(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RUNTIME_DIRECTORY", str(tmp_path))
    settings = ZenohSettings(config=str(folder / "gateway.json5"))
    counted: list[int] = []
    OlderCa(revoked.revocation_state(load_config(folder / "gateway.json5"), settings), counted.append).note(
        {"operator-00"}
    )
    assert counted == []
    assert robot(folder) == []


def shut_out(directory: Path) -> list[Result]:
    file = directory / "gateway.json5"
    return list(holders.shut_out_at_the_robot(load_config(file), ZenohSettings(config=str(file))))


def test_the_list_in_force_is_named_with_its_number_and_date_and_that_there_is_none(folder: Path) -> None:
    certs.folder.issue(folder, "anna", "operator", now=NOW)
    (none,) = shut_out(folder)
    assert (none.verdict, none.sentence.partition(":")[0]) == (Verdict.OK, "there is no list")
    first = certs.moving.revoke(folder, "anna", now=NOW)
    revoked.keep(folder / "revoked.crl", certs.moving.revoke(folder, "operator-40", now=NOW))
    (two,) = shut_out(folder)
    assert (two.verdict, two.sentence) == (Verdict.OK, f"list 2 of {NOW:%Y-%m-%d} shuts out 2")
    (folder / "revoked.crl").write_bytes(first.pem)
    (restored,) = shut_out(folder)
    assert restored.verdict is Verdict.WARNING
    assert "shuts out 2, but list 1 lies in its place" in restored.sentence
    (folder / "revoked.crl").write_bytes(first.pem[:-40])
    (damaged,) = shut_out(folder)
    assert damaged.verdict is Verdict.FAILURE


@pytest.mark.parametrize(("number", "verdict"), [(None, Verdict.WARNING), (1, Verdict.WARNING), (2, Verdict.OK)])
def test_a_laptop_beside_the_ca_sees_that_the_robot_has_an_older_list(
    folder: Path, number: int | None, verdict: Verdict
) -> None:
    identity = Identity(folder / "anna.pem", ca=folder / "ca.pem")
    certs.moving.revoke(folder, "operator-40", now=NOW)
    certs.moving.revoke(folder, "operator-41", now=NOW)
    report = None if number is None else RevocationsReport(number=number, date=NOW)
    (found,) = holders.shut_out_from_the_laptop(report, identity)
    assert found.verdict is verdict
    assert ("names no list" if number is None else f"list {number} of") in found.sentence
    assert ("certs revoke --dir" in found.fix) is (verdict is Verdict.WARNING)
