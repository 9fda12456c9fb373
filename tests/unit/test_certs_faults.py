"""Certificates when something is wrong: nothing overwritten, nothing half made, one sentence for each fault."""

import os
import tempfile
from contextlib import suppress
from functools import partial
from itertools import islice
from pathlib import Path

import pytest

from gateway import certs, durable
from gateway.certs.files import publish
from gateway.errors import ConfigError
from gateway.zenoh_config import load_client_config, load_config
from tests.support.certs_folder import (
    DAY,
    HOSTS,
    MADE_BY_INIT,
    NOW,
    contents,
    fault,
    make_folder,
    names,
    with_one_bit_changed,
)

__all__ = ["make_folder"]  # a fixture


# --- nothing overwritten, nothing half made


def test_an_existing_ca_is_never_replaced(folder: Path) -> None:
    before = contents(folder)
    assert "has a CA already" in fault(lambda: certs.folder.init(folder, HOSTS))
    assert contents(folder) == before
    (folder / "ca.key").unlink()  # kept elsewhere
    assert "has a CA already" in fault(lambda: certs.folder.init(folder, HOSTS))


def test_issue_takes_back_everything_when_the_bundle_cannot_be_made(folder: Path, tmp_path: Path) -> None:
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
def test_hosts_that_cannot_be(tmp_path: Path, hosts: list[str], sentence: str) -> None:
    assert sentence in fault(lambda: certs.folder.init(tmp_path / "D", hosts))
    assert names(tmp_path) == set()


def test_a_folder_without_a_ca(tmp_path: Path) -> None:
    for directory in (tmp_path, tmp_path / "missing"):
        assert "cannot read the key" in fault(partial(certs.folder.issue, directory, "a", "operator"))
    assert "cannot read" in fault(lambda: certs.folder.expiries(tmp_path / "missing"))
    assert "has no certificates" in fault(lambda: certs.folder.expiries(tmp_path))


def test_a_ca_that_is_not_whole(folder: Path, tmp_path: Path) -> None:
    def issue() -> str:
        return fault(lambda: certs.folder.issue(folder, "alice", "operator"))

    key = (folder / "ca.key").read_bytes()
    (folder / "ca.key").write_bytes(b"nonsense")
    assert "holds no unencrypted key" in issue()
    certs.folder.init(tmp_path / "E", HOSTS)
    (folder / "ca.key").write_bytes((tmp_path / "E" / "ca.key").read_bytes())
    assert "do not belong together" in issue()
    (folder / "ca.key").unlink()
    (folder / "ca.key").mkdir()
    assert "is not a file" in issue()
    (folder / "ca.key").rmdir()
    (folder / "ca.key").write_bytes(key)
    (folder / "ca.pem").write_bytes(b"nonsense")
    assert "holds no certificate" in issue()
    assert "holds no certificate" in fault(lambda: certs.folder.expiries(folder))
    assert names(folder) == MADE_BY_INIT


@pytest.mark.filterwarnings("ignore:.*RFC 5280")
def test_a_certificate_with_one_bit_changed_is_listed_or_a_sentence(folder: Path) -> None:
    file = folder / "gateway.pem"
    for changed in islice(with_one_bit_changed(file.read_bytes()), 0, None, 7):  # in each byte
        file.write_bytes(changed)
        with suppress(ConfigError):
            certs.folder.describe(file)


def test_a_ca_that_expired(folder: Path) -> None:
    later = NOW + 3651 * DAY
    assert "expired" in fault(lambda: certs.folder.issue(folder, "alice", "operator", now=later))
    assert "expired" in fault(lambda: certs.folder.renew(folder, "gateway", now=later))


def test_renewing_what_is_not_there_or_anothers(folder: Path, tmp_path: Path) -> None:
    assert "cannot read the certificate" in fault(lambda: certs.folder.renew(folder, "nobody"))
    assert "cannot be a name here" in fault(lambda: certs.folder.renew(folder, "ca"))
    certs.folder.init(tmp_path / "E", HOSTS)
    certs.folder.issue(tmp_path / "E", "eve", "operator")
    (folder / "eve.pem").write_bytes((tmp_path / "E" / "eve.pem").read_bytes())
    assert "was not issued by the CA" in fault(lambda: certs.folder.renew(folder, "eve"))


def test_a_gateway_file_that_is_broken(folder: Path) -> None:
    config = folder / "gateway.json5"
    good = config.read_text()
    config.write_text("{ nonsense")
    assert "gateway.json5" in fault(lambda: certs.folder.issue(folder, "alice", "operator"))
    config.write_text(good.replace("tls/[::]:7447", "tcp/[::]:7447"))
    assert "listens on no tls endpoint" in fault(lambda: certs.folder.issue(folder, "alice", "operator"))


def test_zenoh_files_with_faults(folder: Path) -> None:
    certs.folder.issue(folder, "alice", "operator")
    certs.folder.issue(folder, "old", "operator", days=1, now=NOW - 10 * DAY)
    config = folder / "alice.json5"
    good = config.read_text()
    assert load_client_config(config)
    assert "cannot read" in fault(lambda: load_client_config(folder / "missing.json5"))
    assert "gateway's own" in fault(lambda: load_client_config(folder / "gateway.json5"))
    assert f"expired on {NOW - 9 * DAY:%Y-%m-%d}" in fault(lambda: load_client_config(folder / "old.json5"))
    config.write_text(good.replace("scouting", "scooting"))
    assert "scooting" in fault(lambda: load_client_config(config))
    config.write_text(good.replace('"alice.key"', '"nowhere.key"'))
    assert "nowhere.key" in fault(lambda: load_client_config(config))
    config.write_text(good.replace('"alice.pem"', '"alice.key"'))
    assert "holds no certificate" in fault(lambda: load_client_config(config))


@pytest.mark.skipif(os.geteuid() != 0, reason="to become another user takes root")
def test_folders_that_one_may_not_write_or_read() -> None:
    """As nobody: to root no folder is closed."""
    with tempfile.TemporaryDirectory() as name:
        top = Path(name)
        top.chmod(0o711)
        certs.folder.init(top / "D", HOSTS)
        (top / "E").mkdir(mode=0o755)
        os.seteuid(65534)
        try:
            said = [
                fault(lambda: certs.folder.init(top / "E", HOSTS)),
                fault(lambda: certs.folder.init(top / "E" / "F", HOSTS)),
                fault(lambda: certs.folder.issue(top / "D", "alice", "operator")),
                fault(lambda: certs.folder.expiries(top / "D")),
                fault(lambda: load_config(top / "D" / "gateway.json5")),
            ]
        finally:
            os.seteuid(0)
        assert ["Permission denied" in text for text in said] == [True] * 5, said
        assert names(top / "E") == set()
        (top / "D" / "gateway.key").chmod(0o600)
        (top / "D").chmod(0o755)  # as on a robot, but the key still belongs to root
        os.seteuid(65534)
        try:
            assert "gateway.key: Permission denied" in fault(lambda: load_config(top / "D" / "gateway.json5"))
        finally:
            os.seteuid(0)
