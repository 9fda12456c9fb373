"""What `check` says of who is shut out."""

from pathlib import Path

import pytest

from gateway import certs
from gateway.onboard.check import holders
from gateway.onboard.check.result import Result, Verdict
from gateway.people.client.requests import Identity
from gateway.robot.sections import ZenohSettings
from gateway.robot.settings import Settings
from gateway.robot.zenoh_io import revoked
from gateway.zenoh_config import load_config
from schemas.telemetry import RevocationsReport
from tests.support.certs_folder import NOW, make_folder

__all__ = ["make_folder"]  # a fixture


def shut_out(directory: Path) -> list[Result]:
    file = directory / "gateway.json5"
    return list(holders.shut_out_at_the_robot(load_config(file), Settings(zenoh=ZenohSettings(config=str(file)))))


def test_the_list_in_force_is_named_with_its_number_and_date_and_that_there_is_none(folder: Path) -> None:
    certs.folder.issue(folder, "anna", "operator", now=NOW)
    (none,) = shut_out(folder)
    assert (none.verdict, none.sentence.partition(":")[0]) == (Verdict.OK, "there is no list")
    first = certs.folder.revoke(folder, "anna", now=NOW)
    revoked.keep(folder / "revoked.crl", certs.folder.revoke(folder, "operator-40", now=NOW))
    (two,) = shut_out(folder)
    assert (two.verdict, two.sentence) == (Verdict.OK, f"list 2 of {NOW:%Y-%m-%d} shuts out 2")
    (folder / "revoked.crl").write_bytes(first.pem[:-40])
    (damaged,) = shut_out(folder)
    assert damaged.verdict is Verdict.FAILURE


@pytest.mark.parametrize(("number", "verdict"), [(None, Verdict.WARNING), (1, Verdict.WARNING), (2, Verdict.OK)])
def test_a_laptop_beside_the_ca_sees_that_the_robot_has_an_older_list(
    folder: Path, number: int | None, verdict: Verdict
) -> None:
    identity = Identity(folder / "anna.pem", ca=folder / "ca.pem")
    certs.folder.revoke(folder, "operator-40", now=NOW)
    certs.folder.revoke(folder, "operator-41", now=NOW)
    report = None if number is None else RevocationsReport(number=number, date=NOW)
    (found,) = holders.shut_out_from_the_laptop(report, identity)
    assert found.verdict is verdict
    assert ("names no list" if number is None else f"list {number} of") in found.sentence
    assert ("certs revoke --dir" in found.fix) is (verdict is Verdict.WARNING)
