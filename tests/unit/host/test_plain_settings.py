"""What `stop-servos` reads by itself is what the settings say, or is left to them."""

from pathlib import Path

import pytest

from gateway.errors import ConfigError
from gateway.host import plain_settings
from gateway.host.plain_settings import PlainPower, PlainSpi
from gateway.model.framing import Framing
from gateway.robot import settings

WHOLE = """
[spi]
framing = "length-prefixed"
device = "/dev/spidev1.2"
speed_hz = 500_000
frame_gap_us = 60
resync_ms = 0.5
batch = false
avoid_deg = [2.0, 3.0]
[watchdog]
timeout_ms = 300
repeats = 7
repeat_interval_ms = 33.5
"""


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.delenv("HEXAPOD_SPI__FRAMING", raising=False)
    return tmp_path / "gateway.toml"


ELKAPOD = 'spi.protocol = "elkapod-2025"\n'


@pytest.mark.parametrize(
    "text",
    [
        WHOLE,
        'spi.framing = "plain"\n',
        'spi.framing = "length-prefixed"\nwatchdog = {}\n',
        ELKAPOD,
        'spi.framing = "plain"\n[power]\ninterface = "slcan"\nchannel = "/dev/ttyACM0"\nconfirm_ms = 500\n',
        ELKAPOD + 'spi.speed_hz = 2_000_000\n[controller]\nuart = "/dev/ttyS3"\nsilent_ms = 400\n',
    ],
)
def test_the_same_as_the_settings(file: Path, text: str) -> None:
    """Its defaults, too, and no setting of the device is missing."""
    file.write_text(text)
    found = plain_settings.read(file)
    assert found is not None
    spi, controller, power = found
    theirs = settings.load(file, for_stops=True)
    assert spi._asdict() == {name: getattr(theirs.spi, name) for name in type(theirs.spi).model_fields}
    assert controller.uart == theirs.controller.uart
    assert power is not None
    assert power._asdict() == {name: getattr(theirs.power, name) for name in PlainPower._fields}


NOT_PLAIN = [
    "",
    "[spi]\n",
    "spi = 3\n",
    'spi.framing = "Plain"\n',
    'spi.framing = "plain"\nspi.speed = 5\n',
    'spi.framing = "plain"\nspi.speed_hz = "5"\n',
    'spi.framing = "plain"\nspi.speed_hz = true\n',
    'spi.framing = "plain"\nspi.speed_hz = 5.0\n',
    'spi.framing = "plain"\nspi.frame_gap_us = nan\n',
    'spi.framing = "plain"\nspi.device = "spidev0.0"\n',
    'spi.framing = ["plain"]\n',
    'spi.framing = "plain"\ncontroller = 3\n',
    'spi.framing = "plain"\nspi.protocol = "elkapod"\n',
    'spi.protocol = "hexapod-1.0"\n',
    'spi.protocol = "elkapod-2025"\ncontroller.uart = "ttyAMA1"\n',
    "no TOML",
]


@pytest.mark.parametrize("text", NOT_PLAIN, ids=repr)
def test_what_is_not_plainly_right_is_left_to_the_settings(file: Path, text: str) -> None:
    file.write_text(text)
    assert plain_settings.read(file) is None


@pytest.mark.parametrize("power", ["3", "{interface = 3}", "{channel = 0}"])
def test_a_wrong_power_board_is_none_and_the_rest_counts(file: Path, power: str) -> None:
    file.write_text(f'spi.framing = "plain"\npower = {power}\n')
    found = plain_settings.read(file)
    assert found is not None
    assert found.power is None
    with pytest.raises(ConfigError, match="power"):
        settings.load(file)


# ---- what the framing allows: the settings reject what is beyond, and stop-servos takes the nearest


PREFIXED = 'spi.framing = "length-prefixed"\n'
TOO_FAST = {
    "spi.speed_hz = 5_000_001\n": (5_000_000, 50.0, "speed_hz is 5000001, and length-prefixed allows 5000000 at most"),
    "spi.speed_hz = 20_000_000\n": (5_000_000, 50.0, "speed_hz is 20000000"),
    "spi.frame_gap_us = 19.9\n": (2_500_000, 20.0, "frame_gap_us is 19.9, and length-prefixed wants 20 at least"),
    "spi.frame_gap_us = 0\nspi.speed_hz = 6_000_000\n": (5_000_000, 20.0, "6000000"),
}


@pytest.mark.parametrize("values", TOO_FAST)
def test_what_the_service_rejects_stop_servos_writes_as_the_framing_allows(file: Path, values: str) -> None:
    speed_hz, gap_us, sentence = TOO_FAST[values]
    file.write_text(PREFIXED + values)
    with pytest.raises(ConfigError, match=f"gateway.toml: spi: .*{sentence}"):
        settings.load(file)
    read = plain_settings.read(file)
    assert read is not None
    for found in (read[0], settings.load(file, for_stops=True).spi):
        spi, changed = plain_settings.within_limits(found)
        assert spi == PlainSpi(Framing.LENGTH_PREFIXED, speed_hz=speed_hz, frame_gap_us=gap_us)
        assert sentence in changed
        assert changed.endswith(f"stop-servos uses {speed_hz} Hz and {gap_us:g} µs")


def test_a_variable_that_is_too_fast_is_rejected_by_its_name_and_stops_all_the_same(
    file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file.write_text(PREFIXED)
    monkeypatch.setenv("HEXAPOD_SPI__SPEED_HZ", "8000000")
    with pytest.raises(ConfigError, match="HEXAPOD_SPI__SPEED_HZ: speed_hz is 8000000"):
        settings.load(file)
    assert settings.load(file, for_stops=True).spi.speed_hz == 8_000_000


def test_no_setting_of_an_earlier_version_prevents_a_stop(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Which the service rejects."""
    file.write_text(WHOLE + "[lease]\ntakeover = 'never'\n[log]\nlevel = 'info'\n[zenoh]\nconnect = []\n")
    monkeypatch.setenv("HEXAPOD_SPI__BATCH", "false")
    assert settings.load(file, for_stops=True).spi.framing is Framing.LENGTH_PREFIXED
    with pytest.raises(ConfigError) as raised:
        settings.load(file)
    assert {line.rpartition(": ")[0].rpartition(": ")[2] for line in str(raised.value).splitlines()} == {
        "spi.resync_ms",
        "spi.batch",
        "spi.avoid_deg",
        "watchdog.repeats",
        "watchdog.repeat_interval_ms",
        "lease.takeover",
        "log",
        "zenoh.connect",
        "HEXAPOD_SPI__BATCH",
    }
