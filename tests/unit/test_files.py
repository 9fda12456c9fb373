"""Files and foreign text: replaced whole, and of another encoding, kind, size or depth; each fault is a sentence."""

import errno
import os
import stat
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import pytest
import zenoh

from gateway import certs, geometry
from gateway.errors import ConfigError
from gateway.files import durable, nesting
from gateway.files.nesting import MOST_BYTES, MOST_DOTS, MOST_LEVELS
from gateway.people.commands import calibration
from gateway.robot import settings
from gateway.robot.settings import Settings
from gateway.robot.zenoh_io.session import service_config
from gateway.words.text import decimal_comma, visible
from gateway.zenoh.config import one_line, why_not_opened


@pytest.mark.parametrize("data", ["spi.framing = 1".encode("utf-16"), b"\0" * 300, b"a = 1\n\0", b"# \xe4"])
def test_toml_that_is_not_text_is_named(data: bytes) -> None:
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


def test_zenohs_errors_are_shortened_and_a_wrong_key_is_named() -> None:
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


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("Zoë drives 火星", "Zoë drives 火星"),
        ('it\'s "C:\\"\a', r"""it's "C:\"\x07"""),
        ("eve\x1b[2J\nok\r", r"eve\x1b[2J\nok\r"),
        ("\x00\x7f\x9b\u2028\ud800\U000e0001", r"\x00\x7f\x9b\u2028\ud800\U000e0001"),
    ],
)
def test_what_cannot_be_printed_is_escaped(text: str, shown: str) -> None:
    assert visible(text) == shown


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ('{"op":"set","angle_deg":45,5}', "45,5 has a decimal comma; write 45.5"),
        ("[watchdog]\ntimeout_ms = 250,5\nscope = 1\n", "250,5 has a decimal comma; write 250.5"),
        ("min_deg = -1,5  # less", "-1,5 has a decimal comma; write -1.5"),
        ('{"a":[45,5]}', ""),
        ('{"a":45,"b":5}', ""),
        ('{"source":"at 45,5"', ""),
    ],
)
def test_a_decimal_comma_is_named(text: str, sentence: str) -> None:
    assert decimal_comma(text) == sentence


# ---- before anything parses them


DEEP = MOST_LEVELS + 1


@pytest.mark.parametrize(
    "text",
    [
        "[" * 100_000,
        "[/*]*/" * DEEP,
        r'["\"]",' * DEEP,
        '{"a":[' * DEEP,
    ],
)
def test_json5_that_nests_too_deep_is_rejected(text: str) -> None:
    with pytest.raises(ValueError, match="nests deeper than 100 levels"):
        nesting.check(text.encode())


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("a" + ".a" * 100_000 + "=1", f"a line with more than {MOST_DOTS} dots"),
        ("a" + ".a" * MOST_LEVELS + "=1", "nests deeper"),
        ("a=" + "[" * DEEP + "]" * DEEP, "nests deeper"),
        ("#" * (MOST_BYTES + 1), f"more than {MOST_BYTES} bytes"),
        ("a = ", "is not TOML: "),
    ],
)
def test_toml_too_deep_too_large_or_malformed_is_rejected(text: str, why: str) -> None:
    with pytest.raises(ValueError, match=why):
        nesting.read_toml(text.encode())


def test_toml_may_begin_with_a_byte_order_mark() -> None:
    assert nesting.read_toml(b"\xef\xbb\xbf[spi]\nspeed_hz = 1\n") == {"spi": {"speed_hz": 1}}


def with_replacing(path: Path, data: bytes) -> None:
    """Write by `replacing`, piece by piece."""
    with durable.replacing(path) as staged:
        staged.write_bytes(data)
        durable.sync(staged)


WRITERS = [durable.write, partial(durable.write_with_mode, mode=0o640), with_replacing]
Writer = Callable[[Path, bytes], None]


def no_space(*_: object) -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@pytest.mark.parametrize("write", WRITERS)
@pytest.mark.parametrize("broken_call", [(os, "fsync"), (Path, "replace")])
def test_a_full_disk_leaves_the_old_file_and_is_reported_with_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, write: Writer, broken_call: tuple[object, str]
) -> None:
    path = tmp_path / "file"
    write(path, b"old")
    assert path.read_bytes() == b"old"
    with monkeypatch.context() as broken:
        broken.setattr(*broken_call, no_space)
        with pytest.raises(OSError, match="No space left") as raised:
            write(path, b"new")
    assert raised.value.filename == str(path), "the call that found it knows no name"
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("write", WRITERS)
def test_the_file_is_on_the_disk_before_it_takes_its_place_and_the_folder_after_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, write: Writer
) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"old")
    synced: list[tuple[int | None, bytes]] = []

    def fsync(descriptor: int) -> None:
        status = os.fstat(descriptor)
        synced.append((status.st_size if stat.S_ISREG(status.st_mode) else None, path.read_bytes()))

    monkeypatch.setattr(os, "fsync", fsync)
    write(path, b"new")
    assert synced == [(3, b"old"), (None, b"new")]


@pytest.mark.parametrize("umask", [0o000, 0o077])
def test_the_mode_is_set_before_the_content_with_any_umask(tmp_path: Path, umask: int) -> None:
    path = tmp_path / "file"
    path.touch(0o644)
    found: list[tuple[int, int]] = []

    def look(descriptor: int) -> None:
        status = os.fstat(descriptor)
        found.append((stat.S_IMODE(status.st_mode), status.st_size))

    before = os.umask(umask)
    try:
        durable.write_with_mode(path, b"secret", 0o604, prepare=look)
    finally:
        os.umask(before)
    assert found == [(0o604, 0)]
    assert stat.S_IMODE(path.stat().st_mode) == 0o604


def test_two_simultaneous_writers_leave_one_whole_file(tmp_path: Path) -> None:
    """The second begins and ends within the first."""
    path = tmp_path / "file"
    durable.write_with_mode(
        path, b"first", 0o600, prepare=lambda _: durable.write_with_mode(path, b"the second", 0o600)
    )
    assert (path.read_bytes(), list(tmp_path.iterdir())) == (b"first", [path])


def test_only_one_thread_at_a_time_is_in_a_locked_block(tmp_path: Path) -> None:
    path = tmp_path / "count.json"
    path.write_text("0")

    def count_on(_: int) -> None:
        with durable.locked(path):
            path.write_text(str(int(path.read_text()) + 1))

    with ThreadPoolExecutor(4) as pool:
        list(pool.map(count_on, range(100)))
    assert path.read_text() == "100"
