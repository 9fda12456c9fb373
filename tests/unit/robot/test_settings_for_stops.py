"""What `stop-servos` reads: as little of a file and the environment as it needs, and nothing else prevents a Stop."""

from pathlib import Path

import pytest

from gateway.errors import ConfigError
from gateway.host.settings_table import SpiSettings
from gateway.model.framing import Framing
from gateway.robot import settings

pytestmark = pytest.mark.usefixtures("_clean_environment")

FRAMED = 'spi.framing = "plain"\n'
PREVENTING = [
    ("", "is not set"),
    ("[spi]\n", "is not set"),
    ("spi = 3\n", "spi: 3"),
    ('spi.framing = "Plain"\n', "spi.framing"),
    (FRAMED + "spi.speed = 5\n", "spi.speed: is no setting"),
    (FRAMED + 'spi.speed_hz = "5"\n', "spi.speed_hz"),
    (FRAMED + 'spi.device = "spidev0.0"\n', "spi.device"),
    (FRAMED + 'wire.name = "elkapod"\n', "wire"),
    ('wire.name = ["hexapod-1.0"]\n', "wire.name"),
    ("wire = 3\n", "wire: 3"),
    (FRAMED + 'spi.protocol = "elkapod-2025"\n', "spi.protocol"),
    ('wire.name = "hexapod-1.0"\n', "spi.framing: is not set"),
    ('wire.name = "elkapod-2025"\ncontroller.uart = "ttyAMA1"\n', "controller.uart"),
    (FRAMED + "controller = 3\n", "controller: 3"),
    ("no TOML", "is not TOML"),
]


@pytest.mark.parametrize(("text", "sentence"), PREVENTING)
def test_with_a_wrong_wire_nothing_is_written_that_could_jam_a_controller(file: Path, text: str, sentence: str) -> None:
    file.write_text(text)
    with pytest.raises(ConfigError, match=sentence):
        settings.load_for_stops(file)


def test_a_variable_of_the_wire_that_is_wrong_or_misnamed(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file.write_text(FRAMED)
    for variable, text in (("HEXAPOD_SPI__SPEED_HZ", "x"), ("HEXAPOD_SPI__SPED_HZ", "1")):
        monkeypatch.setenv(variable, text)
        with pytest.raises(ConfigError, match=variable):
            settings.load_for_stops(file)
        monkeypatch.delenv(variable)


@pytest.mark.parametrize(
    "text",
    [
        "x = 1\n[watchdog]\ntimeout_ms = 1\n",
        "[controller]\nsilent_ms = 'x'\ny = 1\n",
        "[safety]\nmax_tilt_deg = 45\n",
        "[power]\nconfirm_ms = 1\n",
        # of earlier versions
        "[spi]\nframing = 'plain'\nresync_ms = 0.5\nbatch = false\navoid_deg = [2.0, 3.0]\n[watchdog]\nrepeats = 7\n",
        "[lease]\ntakeover = 'never'\n[log]\nlevel = 'info'\n[zenoh]\nconnect = []\n",
    ],
)
def test_nothing_else_prevents_a_stop(file: Path, monkeypatch: pytest.MonkeyPatch, text: str) -> None:
    file.write_text(text if "framing" in text else FRAMED + text)
    for variable in ("HEXAPOD_SPI__BATCH", "HEXAPOD_WATCHDOG__TIMEOUT_MS", "HEXAPOD_X"):
        monkeypatch.setenv(variable, "false")
    wire, spi, _, power = settings.load_for_stops(file)
    assert spi == SpiSettings().of(wire)
    assert power is not None
    with pytest.raises(ConfigError):
        settings.load(file)


@pytest.mark.parametrize("power", ["3", "{interface = 3}", "{channel = 0}", '{interface = "gs_usb"}'])
def test_a_wrong_power_board_is_none_and_the_rest_counts(file: Path, power: str) -> None:
    file.write_text(f"{FRAMED}power = {power}\n")
    assert settings.load_for_stops(file).power is None


def test_it_is_what_the_service_uses(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file.write_text('wire.name = "elkapod-2025"\ncontroller.uart = "/dev/ttyS3"\npower.interface = "slcan"\n')
    monkeypatch.setenv("HEXAPOD_SPI__DEVICE", "/dev/spidev1.0")
    theirs = settings.load(file)
    assert settings.load_for_stops(file) == (theirs.wire, theirs.spi, theirs.controller, theirs.power)


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
    with pytest.raises(ConfigError, match=f": spi: .*{sentence}"):
        settings.load(file)
    spi, changed = settings.load_for_stops(file).spi.within_limits()
    assert spi == SpiSettings(framing=Framing.LENGTH_PREFIXED, speed_hz=speed_hz, frame_gap_us=gap_us)
    assert sentence in changed
    assert changed.endswith(f"stop-servos uses {speed_hz} Hz and {gap_us:g} µs")


def test_a_variable_that_is_too_fast_is_rejected_by_its_name_and_stops_all_the_same(
    file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file.write_text(PREFIXED)
    monkeypatch.setenv("HEXAPOD_SPI__SPEED_HZ", "8000000")
    with pytest.raises(ConfigError, match="HEXAPOD_SPI__SPEED_HZ: speed_hz is 8000000"):
        settings.load(file)
    assert settings.load_for_stops(file).spi.speed_hz == 8_000_000
