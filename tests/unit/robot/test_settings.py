"""Settings from a file and the environment: defaults, what overrides what, ranges, and what is said of faults."""

import os
import re
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from gateway.errors import ConfigError
from gateway.host.settings_reader import ForStops
from gateway.host.settings_table import LimitSettings, ServoLimits, SpiSettings, WatchdogSettings
from gateway.model.frames import Framing
from gateway.robot import settings
from gateway.robot.settings import FramingNotSetError, Settings
from release import interface_page

NO_VARIABLE = "is no setting; a variable is named like HEXAPOD_SPI__DEVICE"
WORD = "is not allowed: input should be"
INTEGER = f"{WORD} a valid integer"
NUMBER = f"{WORD} a valid number"
STRING = f"{WORD} a valid string"
FINITE = f"{WORD} a finite number"
LIST = f'{WORD} a valid array, such as ["tcp/127.0.0.1:7447"]'
NO_SERVO = "is no servo; an id is the leg (1 to 6) and the joint (1 to 3), such as 32"

FILE_FAULTS = [
    # unknown names
    ("x = 1", "x: is no setting"),
    ("[spi]\nsped_hz = 1", "spi.sped_hz: is no setting"),
    ('[spi]\n"a\\nb" = 1', r'spi."a\nb": is no setting'),
    ("[limits.servos.14]", f"limits.servos: 14 {NO_SERVO}"),
    ("[watchdog.landing]\n11 = 170\n[limits.servos.11]\nmax_deg = 120",
     "watchdog.landing.11: 170 is not allowed: limits.servos.11 allows 0 to 120"),
    # wrong types: nothing is converted
    ("spi = 3", "spi: 3 is not allowed: input should be an object"),
    ('[spi]\nspeed_hz = "1"', f'spi.speed_hz: "1" {INTEGER}'),
    ("[spi]\ndevice = 1979-05-27", f'spi.device: "1979-05-27" {STRING}'),
    ('[spi]\ndevice = "/dev/\\u0000"', "spi.device: write the path of a device, such as /dev/spidev0.0"),
    ("[watchdog]\ntimeout_ms = true", f"watchdog.timeout_ms: true {NUMBER}"),
    ('[power]\ninterface = "gs_usb"',
     'power.interface: Linux has a driver for this adapter: write interface = "socketcan", channel = "can0"'),
    ('[zenoh]\nlisten = "tcp/a"', f'zenoh.listen: "tcp/a" {LIST}'),
    # not among the words
    ('[spi]\nframing = "Plain"', "spi.framing: \"Plain\" is not allowed: input should be 'plain' or 'length-prefixed'"),
    ('[wire]\nname = "elkapod"',
     'wire: there is no wire "elkapod"; installed are "hexapod-1.0", "elkapod-2025"'),
    ("[wire]\nbaud = 9600", "wire: baud is no setting of hexapod-1.0"),
    # no finite number
    ("[limits]\nleg_rate_hz = nan", f"limits.leg_rate_hz: NaN {FINITE}"),
    # values that do not go together, or have a form
    ("[limits.servos.11]\nmin_deg = 170\nmax_deg = 160",
     "limits.servos.11: min_deg is 170 and max_deg 160; min_deg must not be larger"),
    *((f'[telemetry]\nmetrics = "{text}"',
       'telemetry.metrics: write a host and a port, such as "127.0.0.1:9464", or "" for none')
      for text in ("9464", ":9464", "localhost:0", "localhost:65536", "localhost:٣")),
    ("[power]\nservos = [11, 11]",
     "power.servos: write all 18 servos, each once, in the order of the board's outputs, or [] for 11 to 63"),
    ('[buttons]\nnames = [""]', "buttons.names: write at most 64 names, each of 1 to 64 characters"),
    ("[safety]\nmax_tilt_deg = 45", "safety.max_tilt_deg: hexapod-1.0 has nothing that measures it; leave it at 0"),
    ('[wire]\nname = "elkapod-2025"\n[limits]\nstart_stagger_ms = 1',
     "limits.start_stagger_ms: elkapod-2025 starts all servos at once, so leave it at 0"),
    ("[limits]\nstart_stagger_ms = 250",
     "limits.start_stagger_ms: a leg's start may not wait for as long as watchdog.timeout_ms, 250"),
    ('[wire]\nname = "elkapod-2025"\n[safety]\nmax_tilt_deg = 9',
     "safety.max_tilt_deg: write 10 to 90, since a robot that walks tilts by some degrees, or 0 for never"),
]  # fmt: skip


ENVIRONMENT_FAULTS = [
    ("HEXAPOD_SPI__SPED_HZ", "1", NO_VARIABLE),
    ("HEXAPOD_SPI_DEVICE", "x", NO_VARIABLE),
    ("hexapod_spi__device", "x", NO_VARIABLE),
    ("HEXAPOD_LIMITS__SERVOS__14__MIN_DEG", "1", f"14 {NO_SERVO}"),
    ("HEXAPOD_SPI__SPEED_HZ", "1e6", f"1000000.0 {INTEGER}"),
    ("HEXAPOD_WATCHDOG__TIMEOUT_MS", "nan", f"NaN {FINITE}"),
    ("HEXAPOD_TELEMETRY__FRAMES", "maybe", '"maybe" is not allowed: input should be a valid boolean'),
    ("HEXAPOD_SPI__FRAMING", "x\ny", r'"x\ny" is not allowed: '
     "input should be 'plain' or 'length-prefixed'"),
    ("HEXAPOD_ZENOH__LISTEN", "tcp/a", f""""tcp/a" {LIST}"""),
    ("HEXAPOD_ZENOH__LISTEN", "[" * 5000, f""""{"[" * 79}… {LIST}"""),
    ("HEXAPOD_ZENOH__LISTEN", '"a"', f'"a" {LIST}'),
    ("HEXAPOD_WIRE__BAUD", "9600", NO_VARIABLE),
    ("HEXAPOD_TELEMETRY__METRICS", "x", 'write a host and a port, such as "127.0.0.1:9464", or "" for none'),
]  # fmt: skip

pytestmark = pytest.mark.usefixtures("_clean_environment")

# ---- where settings come from


def load(path: Path | None = None) -> Settings:
    return settings.load(path, simulated=True)


def faults(path: Path | None = None) -> list[str]:
    """Return the lines of the ConfigError, the file's path cut off to `file`."""
    with pytest.raises(ConfigError) as raised:
        load(path)
    assert raised.value.exit_code == 2
    lines = str(raised.value).split("\n")
    assert all(line.isprintable() for line in lines), lines
    return [line.replace(str(path), "file") for line in lines]


@pytest.mark.parametrize(("text", "frames"), [("1", True), ("yes", True), ("On", True), ("0", False), ("off", False)])
def test_a_boolean_variable_has_the_usual_words(monkeypatch: pytest.MonkeyPatch, text: str, frames: bool) -> None:
    monkeypatch.setenv("HEXAPOD_TELEMETRY__FRAMES", text)
    assert load().telemetry.frames is frames


# ---- values out of range, or anything


RANGES: dict[str, tuple[float, float]] = {
    name.replace(".N.", ".32."): setting.allowed.limits
    for name, setting in interface_page.settings().items()
    if setting.allowed.limits is not None and name != "watchdog.landing.N"
}


@pytest.mark.parametrize("place", RANGES)
def test_a_range_holds_at_both_ends(file: Path, monkeypatch: pytest.MonkeyPatch, place: str) -> None:
    low, high = RANGES[place]
    variable = f"HEXAPOD_{place.upper().replace('.', '__')}"
    protocol = "elkapod-2025" if place.startswith("safety.") else "hexapod-1.0"  # what only that one measures
    monkeypatch.setenv("HEXAPOD_WIRE__NAME", protocol)
    other = "watchdog.timeout_ms = 10000\n" if place == "limits.start_stagger_ms" else ""  # which has to be below it
    if other:
        monkeypatch.setenv("HEXAPOD_WATCHDOG__TIMEOUT_MS", "10000")
    for value in (low, high):
        file.write_text(f'wire.name = "{protocol}"\n{other}{place} = {value}')
        load(file)
        monkeypatch.setenv(variable, str(value))
        assert load() == load(file)
        monkeypatch.delenv(variable)
    for value, limit in ((low - 1, f"greater than or equal to {low}"), (high + 1, f"less than or equal to {high}")):
        file.write_text(f'wire.name = "{protocol}"\n{place} = {value}')
        assert faults(file) == [f"file: {place}: {value} is not allowed: input should be {limit}"]
        monkeypatch.setenv(variable, str(value))
        assert faults() == [f"{variable}: {value} is not allowed: input should be {limit}"]
        monkeypatch.delenv(variable)


def test_every_number_has_a_range_that_is_tested() -> None:
    numbers = {
        f"{section}.{name}"
        for section, table in asdict(Settings()).items()
        for name, value in table.items()
        if isinstance(value, int | float) and not isinstance(value, bool)
    }
    assert numbers | {f"limits.servos.32.{name}" for name in asdict(ServoLimits())} == RANGES.keys()


toml_values = st.recursive(
    st.one_of(st.booleans(), st.integers(), st.floats(), st.text(st.characters(codec="ascii", categories=["L", "N"]))),
    lambda inner: st.lists(inner, max_size=3),
    max_leaves=4,
)
PLACES = [f"{section}.{name}" for section, table in asdict(Settings()).items() for name in table]


@given(st.dictionaries(st.sampled_from([*PLACES, "limits.servos.11.min_deg", "spi.x", "x"]), toml_values, max_size=4))
@hypothesis_settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_values_are_settings_or_faults(file: Path, values: dict[str, Any]) -> None:
    file.write_text("".join(f"{place} = {_toml(value)}\n" for place, value in values.items()))
    try:
        load(file)
    except ConfigError as error:
        lines = str(error).split("\n")
    else:
        return
    assert all(line.isprintable() and line.startswith(f"{file}: ") for line in lines)


def _toml(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return f"[{', '.join(map(_toml, value))}]" if isinstance(value, list) else repr(value)


def test_gateway_toml_says_the_defaults(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The configuration that is installed changes nothing; each default in it is the true one, and none is left out."""
    monkeypatch.setenv("HEXAPOD_CONNECT", "tcp/192.0.2.7:7447")  # for client commands, and no setting
    installed = Path(__file__).parents[3] / "deploy/gateway.toml"
    assert settings.load(installed, simulated=True) == Settings()
    lines = [line for line in installed.read_text().splitlines() if "json5" not in line]  # the example of another
    uncommented = tmp_path / "gateway.toml"
    uncommented.write_text("\n".join(re.sub(r"^# (\w+ = |\[)", r"\1", line) for line in lines))
    servo = ServoLimits(min_deg=20, max_deg=160)  # and the two examples that are no defaults
    limits = LimitSettings(servos={"11": servo})
    watchdog = WatchdogSettings(landing={"11": 90})
    expected = Settings(limits=limits, watchdog=watchdog)
    assert settings.load(uncommented) == expected
    shown = {match[1] for line in lines if (match := re.match(r"# (\w+) = ", line))}
    named = {name for table in (*asdict(Settings()).values(), asdict(servo)) for name in table}
    assert shown - {"11"} == named - {"landing", "options"}


# ---- faults of the file


@pytest.mark.parametrize(("text", "line"), FILE_FAULTS, ids=lambda text: repr(text)[:50])
def test_a_fault_of_the_file(file: Path, text: str, line: str) -> None:
    file.write_text(text)
    assert faults(file) == [f"file: {line}"]


def test_a_file_that_is_none(file: Path, tmp_path: Path) -> None:
    assert faults(file) == ["file: there is no such file; name another with --config"]
    os.mkfifo(file)
    for none in (tmp_path, file):
        assert faults(none) == ["file: is no regular file"], "at once: a Stop must not wait for a FIFO's writer"


# ---- faults of the environment


@pytest.mark.parametrize(("variable", "text", "line"), ENVIRONMENT_FAULTS)
def test_a_fault_of_the_environment(monkeypatch: pytest.MonkeyPatch, variable: str, text: str, line: str) -> None:
    monkeypatch.setenv(variable, text)
    assert faults() == [f"{variable}: {line}"]


def test_a_pose_in_the_file_that_limits_in_the_environment_forbid(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file.write_text("[watchdog.landing]\n11 = 110")
    monkeypatch.setenv("HEXAPOD_LIMITS__SERVOS__11__MAX_DEG", "100")
    assert faults(file) == ["file: watchdog.landing.11: 110 is not allowed: limits.servos.11 allows 0 to 100"]
    monkeypatch.setenv("HEXAPOD_WATCHDOG__LANDING__11", "101")
    assert faults(file) == ["HEXAPOD_WATCHDOG__LANDING__11: 101 is not allowed: limits.servos.11 allows 0 to 100"]


# ---- the framing of a real device


def test_a_real_device_has_no_framing_unless_somebody_says_it(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file.write_text('[spi]\ndevice = "/dev/spidev0.1"\n')
    with pytest.raises(FramingNotSetError) as raised:
        settings.load(file)
    unset, *wanted = str(raised.value).splitlines()
    assert unset.startswith(f"{file}: spi.framing: is not set")
    assert [line.split(" needs ")[1] for line in wanted] == ['"plain"', '"length-prefixed"']
    assert load(file).spi.framing is Framing.PLAIN, "a simulated controller needs nobody to say it"
    with pytest.raises(FramingNotSetError, match=r"default\.toml: spi.framing: is not set"):
        settings.load()
    monkeypatch.setenv("HEXAPOD_SPI__FRAMING", "length-prefixed")
    assert settings.load(file).spi.framing is settings.load().spi.framing is Framing.LENGTH_PREFIXED


def test_a_removed_setting_or_section_names_what_takes_its_place(file: Path) -> None:
    file.write_text("[log]\n[recorder]\n")  # as earlier versions installed it
    assert load(file) == Settings()
    file.write_text('[telemetry]\nrate_hz = 5\n[recorder]\npath = "/mnt/box"\n')
    assert faults(file) == [
        "file: telemetry.rate_hz: was removed; telemetry is published ten times a second",
        "file: recorder: was removed; name its folder with state.path, the folder for all kept state "
        "(the black box keeps 60 s)",
    ]


# ---- What `stop-servos` reads: as little of a file and the environment as it needs, and nothing else prevents a Stop


FRAMED = 'spi.framing = "plain"\n'
PREVENTING = [
    ("", "is not set"),
    ("spi = 3\n", "spi: 3"),
    ('spi.framing = "Plain"\n', "spi.framing"),
    (FRAMED + "spi.speed = 5\n", "spi.speed: is no setting"),
    (FRAMED + 'spi.device = "spidev0.0"\n', "spi.device"),
    ('spi.protocol = "elkapod-2025"\n', "spi.protocol: was removed; write its value"),
    (FRAMED + 'wire.name = "elkapod"\n', "wire"),
    ('wire.name = ["hexapod-1.0"]\n', "wire.name"),
    ('wire.name = "elkapod-2025"\ncontroller.uart = "ttyAMA1"\n', "controller.uart"),
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
        "[lease]\nttl_ms = 'x'\ny = 1\n",
        "[safety]\nmax_tilt_deg = 45\n",
        "[power]\nconfirm_ms = 1\n",
        # of earlier versions
        "[spi]\nframing = 'plain'\nresync_ms = 0.5\nbatch = false\n[watchdog]\nrepeats = 7\n[log]\nlevel = 'info'\n",
    ],
)
def test_nothing_else_prevents_a_stop(file: Path, monkeypatch: pytest.MonkeyPatch, text: str) -> None:
    file.write_text(text if "framing" in text else FRAMED + text)
    for variable in (
        "HEXAPOD_SPI__BATCH",
        "HEXAPOD_WATCHDOG__TIMEOUT_MS",
        "HEXAPOD_X",
        "HEXAPOD_POWER",
        "HEXAPOD_WIRE__BAUD",
    ):
        monkeypatch.setenv(variable, "false")
    found = settings.load_for_stops(file)
    wire, spi, power = found.wire, found.spi, found.power
    assert spi == SpiSettings().of(wire)
    assert power is not None
    with pytest.raises(ConfigError):
        settings.load(file)


@pytest.mark.parametrize("power", ["3", "{interface = 3}", "{channel = 0}", '{interface = "gs_usb"}'])
def test_a_wrong_power_board_is_none_and_the_rest_counts(file: Path, power: str) -> None:
    file.write_text(f"{FRAMED}power = {power}\n")
    assert settings.load_for_stops(file).power is None


def test_stop_servos_reads_the_settings_that_the_service_uses(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file.write_text('wire.name = "elkapod-2025"\ncontroller.uart = "/dev/ttyS3"\npower.interface = "slcan"\n')
    monkeypatch.setenv("HEXAPOD_SPI__DEVICE", "/dev/spidev1.0")
    theirs = settings.load(file)
    assert settings.load_for_stops(file) == ForStops(theirs.wire, theirs.spi, theirs.controller, theirs.power)


PREFIXED = 'spi.framing = "length-prefixed"\n'
TOO_FAST = {
    "spi.speed_hz = 5_000_001\n": (5_000_000, 50.0, "speed_hz is 5000001, and length-prefixed allows 5000000 at most"),
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


def test_a_simulated_board_beside_a_real_controller_is_a_fault_and_no_stop_minds_it(tmp_path: Path) -> None:
    path = tmp_path / "gateway.toml"
    path.write_text('[spi]\nframing = "plain"\n[power]\ninterface = "sim"\n')
    with pytest.raises(ConfigError, match=r"power\.interface: with a real controller, .*without a robot: run --sim"):
        settings.load(path)
    assert settings.load(path, simulated=True).power.interface == "sim"
    assert settings.load_for_stops(path).power is not None
