"""Every fault of a file or the environment in one line that names its place; a framing that nobody has said."""

import os
from pathlib import Path

import pytest

from gateway.errors import ConfigError
from gateway.robot import settings
from gateway.robot.protocol.framing import Framing
from gateway.robot.settings import FramingNotSetError
from tests.support.bad_settings import ENVIRONMENT_FAULTS, FILE_FAULTS
from tests.support.settings_file import faults, load

pytestmark = pytest.mark.usefixtures("_clean_environment")

# ---- faults of the file


@pytest.mark.parametrize(("text", "line"), FILE_FAULTS, ids=lambda text: repr(text)[:50])
def test_a_fault_of_the_file(file: Path, text: str, line: str) -> None:
    file.write_text(text)
    assert faults(file) == [f"file: {line}"]


def test_each_fault_has_its_line(file: Path) -> None:
    file.write_text('y = 1\n[telemetry]\nstate_hz = -1\nframes = "no"\n[log]\nlevel = "loud"\n[spi]\nx = 1\n')
    assert [line.split(": ")[1] for line in faults(file)] == [
        "spi.x", "telemetry.state_hz", "telemetry.frames", "log.level", "y"
    ]  # fmt: skip


NOT_TOML = {
    "no value": b"[spi]\nspeed_hz =",
    "a string without end": b'[spi]\ndevice = "',
    "a name given twice": b"[spi]\nspeed_hz = 1\nspeed_hz = 2",
    "Latin-1": '[spi]\ndevice = "Gerät"'.encode("latin-1"),
    "a byte order mark": b"\xef\xbb\xbf[spi]",
    "JSON": b'{"spi": {}}',
    "nothing but zeros": bytes(64),
    "a thousand brackets": b"a = " + b"[" * 5000,
    "too many digits": b"a = " + b"9" * 5000,
}


@pytest.mark.parametrize("text", NOT_TOML.values(), ids=NOT_TOML)
def test_what_is_not_toml(file: Path, text: bytes) -> None:
    file.write_bytes(text)
    (line,) = faults(file)
    assert line.startswith("file: is not TOML: ")
    assert len(line) < 250


def test_a_file_that_is_none(file: Path, tmp_path: Path) -> None:
    assert faults(file) == ["file: there is no such file; name another with --config"]
    assert faults(tmp_path) == ["file: cannot be read (Is a directory); name another file with --config"]


def test_a_file_that_may_not_be_read(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file.write_text("")
    if os.geteuid() == 0:  # whom permissions do not stop

        def reject(path: Path, **_: object) -> str:
            raise PermissionError(13, "Permission denied", str(path))

        monkeypatch.setattr(Path, "read_text", reject)
    else:
        file.chmod(0)
    line = "cannot be read (Permission denied); name another file with --config"
    assert faults(file) == [f"file: {line}"]
    monkeypatch.setattr(settings, "DEFAULT_PATH", file)
    assert faults() == [f"{file}: {line}"], "a default file that is there is never passed over"


# ---- faults of the environment


@pytest.mark.parametrize(("variable", "text", "line"), ENVIRONMENT_FAULTS)
def test_a_fault_of_the_environment(monkeypatch: pytest.MonkeyPatch, variable: str, text: str, line: str) -> None:
    monkeypatch.setenv(variable, text)
    assert faults() == [f"{variable}: {line}"]


def test_faults_of_file_and_environment_are_told_at_once(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file.write_text("[spi]\nspeed_hz = 0\n[limits.servos.99]\n")
    for variable in ("HEXAPOD_ZENOH__LISTEN", "HEXAPOD_LOG__LEVEL", "HEXAPOD_SPY", "HEXAPOD_SPI__SPEED_HZ"):
        monkeypatch.setenv(variable, "[")
    monkeypatch.setenv("HEXAPOD_LIMITS__SERVOS__11__MIN_DEG", "5")
    assert [line.split(" ")[:2] for line in faults(file)] == [
        ["file:", "spi.speed_hz:"],
        ["file:", "limits.servos:"],
        ["HEXAPOD_SPY:", "is"],
        ["HEXAPOD_ZENOH__LISTEN:", '"["'],
        ["HEXAPOD_SPI__SPEED_HZ:", '"["'],
        ["HEXAPOD_LOG__LEVEL:", '"["'],
    ]


def test_a_file_that_is_not_toml_does_not_hide_the_environment(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file.write_text("[")
    monkeypatch.setenv("HEXAPOD_LOG__LEVEL", "loud")
    assert [line.split(": ")[0] for line in faults(file)] == ["file", "HEXAPOD_LOG__LEVEL"]


def test_a_fault_of_the_file_stays_one_though_the_environment_overrides_it(
    file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file.write_text("[spi]\nspeed_hz = 0\n")
    monkeypatch.setenv("HEXAPOD_SPI__SPEED_HZ", "1000")
    assert faults(file) == ["file: spi.speed_hz: 0 will not do: input should be greater than or equal to 1"]


def test_values_of_both_that_do_not_go_together(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file.write_text("[limits.servos.11]\nmin_deg = 100\n")
    monkeypatch.setenv("HEXAPOD_LIMITS__SERVOS__11__MAX_DEG", "50")
    assert faults(file) == [
        "HEXAPOD_LIMITS__SERVOS__11__MAX_DEG: min_deg is 100 and max_deg 50; min_deg must not be larger"
    ]


# ---- the framing of a real device


def framing_of(path: Path | None) -> Framing:
    return settings.load(path).spi.framing


def test_a_real_device_has_no_framing_unless_somebody_says_it(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for text in ("", "[spi]\n", '[spi]\ndevice = "/dev/spidev0.1"\n'):
        file.write_text(text)
        with pytest.raises(FramingNotSetError) as raised:
            framing_of(file)
        assert raised.value.exit_code == 2
        published, document = str(raised.value).splitlines()
        assert published.startswith(f"{file}: spi.framing: is not set; the published STM32 firmware needs")
        assert '"length-prefixed"' in published
        assert "reset" in published
        assert document.startswith(f"{file}: spi.framing: ")
        assert '"plain"' in document
        assert load(file).spi.framing is Framing.PLAIN, "a simulated controller needs nobody to say it"
    with pytest.raises(FramingNotSetError, match=f"{settings.DEFAULT_PATH}: spi.framing: is not set"):
        framing_of(None)
    for framing in Framing:
        file.write_text(f'[spi]\nframing = "{framing}"\n')
        assert framing_of(file) is load(file).spi.framing is framing
        file.write_text("")
        monkeypatch.setenv("HEXAPOD_SPI__FRAMING", framing)
        assert framing_of(file) is framing_of(None) is framing
        monkeypatch.delenv("HEXAPOD_SPI__FRAMING")


def test_other_faults_are_told_beside_a_framing_that_is_not_set(file: Path) -> None:
    file.write_text("[spi]\nspeed_hz = 0\n")
    with pytest.raises(FramingNotSetError) as raised:
        framing_of(file)
    assert [line.split(": ")[1] for line in str(raised.value).splitlines()] == [
        "spi.speed_hz", "spi.framing", "spi.framing"
    ]  # fmt: skip


@pytest.mark.parametrize("text", ["[", "spi = 3", '[spi]\nframing = "Plain"'])
def test_what_cannot_be_read_is_told_for_itself(file: Path, text: str) -> None:
    file.write_text(text)
    with pytest.raises(ConfigError) as raised:
        framing_of(file)
    assert str(raised.value).splitlines() == [line.replace("file", str(file), 1) for line in faults(file)]
