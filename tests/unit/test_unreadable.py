"""Files of another encoding or kind, too many faults, keys of another set: each is a sentence, and nothing waits."""

import os
from io import FileIO
from pathlib import Path

import pytest
import zenoh

from gateway import certs, geometry
from gateway.errors import ConfigError
from gateway.files import durable, nesting
from gateway.people.commands import calibration
from gateway.robot import settings
from gateway.robot.settings import Settings
from gateway.robot.zenoh_io.session import service_config
from gateway.zenoh.config import one_line, why_not_opened


@pytest.mark.parametrize("data", ["spi.framing = 1".encode("utf-16"), b"\0" * 300, b"a = 1\n\0", b"# \xe4"])
def test_toml_that_is_no_text_is_named_as_that(data: bytes) -> None:
    with pytest.raises(ValueError, match="is no text in UTF-8: saved in another encoding"):
        nesting.read_toml(data)


def test_a_fifo_is_no_file_and_nobody_waits_for_its_writer(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "fifo")
    with pytest.raises(ConfigError, match=r"fifo: cannot be read \(is no regular file\)"):
        geometry.load(tmp_path / "fifo")
    with pytest.raises(ConfigError, match="fifo cannot be read: is no regular file"):
        calibration.import_file(pytest.fail, tmp_path / "fifo", agreed=True)


def test_of_many_faults_the_first_are_named_and_the_rest_counted(tmp_path: Path) -> None:
    """Without a framing that is named, too, since `setup` asks for it."""
    path = tmp_path / "gateway.toml"
    for framing, lines, last in (('spi.framing = "plain"', 21, "and 480 more faults"), ("", 20, '"length-prefixed"')):
        path.write_text("\n".join([framing, *(f"name{number} = 1" for number in range(500))]))
        with pytest.raises(ConfigError) as raised:
            settings.load(path)
        said = str(raised.value).splitlines()
        assert (len(said), said[-1].endswith(last)) == (lines, True)


def test_endpoints_beyond_those_of_any_machine_are_rejected() -> None:
    listen = [f"tcp/127.0.0.{number}:7447" for number in range(1, 66)]
    assert service_config(Settings.of({"zenoh": {"listen": listen[:64]}}).zenoh)
    with pytest.raises(ConfigError, match="lists 65 endpoints to listen on: at most 64"):
        service_config(Settings.of({"zenoh": {"listen": listen}}).zenoh)


def test_what_zenoh_quotes_of_a_file_is_cut_and_its_words_for_a_key_are_ours() -> None:
    assert len(one_line(zenoh.ZError("x" * 800_000))) == 301
    assert "a private key that is not its certificate's: sudo hex" in why_not_opened(
        "may not: KeyMismatch", ["tls/x:1"]
    )


def test_files_that_contradict_each_other_are_told_from_those_of_an_unknown_chain(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An authority of another name may have signed one between. One of the same name has not."""
    for name, number in (("own", "1"), ("other", "2"), ("namesake", "1")):
        monkeypatch.setattr("secrets.token_hex", lambda _, number=number: number)
        certs.folder.init(tmp_path / name, ["127.0.0.1"])

    def fault(ca: str = "own", key: str = "own") -> str:
        own, theirs = tmp_path / "own", tmp_path / ca / "ca.pem"
        return certs.folder.contradiction(theirs, own / "gateway.pem", tmp_path / key / "gateway.key")

    assert (fault(), fault(ca="other")) == ("", "")
    assert fault(key="other").endswith("own, gateway.key is not the key of gateway.pem")
    assert fault(ca="namesake").endswith("gateway.pem is of another authority than ca.pem, which has the same name")


def test_a_full_disk_is_told_with_the_file(tmp_path: Path) -> None:
    with Path("/dev/full").open("wb", buffering=0) as full, pytest.raises(OSError, match="No space") as raised:
        fill(tmp_path / "a", full)
    assert raised.value.filename == str(tmp_path / "a")
    assert not list(tmp_path.iterdir())


def fill(path: Path, full: FileIO) -> None:
    with durable.replacing(path) as staged:
        staged.write_text("x")
        full.write(b"x")
