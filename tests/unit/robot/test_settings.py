"""Settings from a file and the environment: defaults, what overrides what, ranges, and what is said of faults."""

import json
import os
import re
import tomllib
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from pydantic import BaseModel, ValidationError

from gateway.errors import ConfigError
from gateway.model.framing import Framing
from gateway.robot import settings
from gateway.robot.sections import (
    LimitSettings,
    PowerSettings,
    ServoLimits,
    SpiSettings,
    WatchdogSettings,
)
from gateway.robot.settings import FramingNotSetError, Settings
from tests.support.bad_settings import ENVIRONMENT_FAULTS, FILE_FAULTS
from tests.support.settings_file import faults, load
from tests.unit import test_interface

pytestmark = pytest.mark.usefixtures("_clean_environment")

# ---- where settings come from


def in_toml(made: Settings) -> str:
    """A file that has each setting, as it is."""
    sections = made.model_dump(mode="json", exclude_none=True)
    return "".join(
        f"{section}.{name} = {_toml(value)}\n" for section in sections for name, value in sections[section].items()
    )


def test_the_defaults_may_be_written_down(file: Path) -> None:
    """Which they are is in docs/interface.md (tests/unit/test_interface.py)."""
    file.write_text(in_toml(Settings()))
    assert load(file) == load() == Settings()


def test_an_empty_file_and_empty_tables_leave_the_defaults(file: Path) -> None:
    for text in ("", "[spi]\n[limits.servos.11]\n[log]\n"):
        file.write_text(text)
        made = load(file)
        assert made.model_copy(update={"limits": Settings().limits}) == Settings()
        assert all(servo == ServoLimits(min_deg=0, max_deg=180) for servo in made.limits.servos.values())


CHANGED = """
[zenoh]
listen = ["tls/0.0.0.0:7447", "tcp/127.0.0.1:7448"]
connect = ["tcp/10.0.0.1:7447"]
config = "/etc/zenoh.json5"
allow_insecure = true
[spi]
protocol = "elkapod-2025"
device = "/dev/spidev1.1"
speed_hz = 1
framing = "length-prefixed"
frame_gap_us = 20.5
batch = false
resync_ms = 0
avoid_deg = []
[controller]
uart = "/dev/ttyAMA0"
silent_ms = 2000
[limits]
leg_rate_hz = 1000
max_age_ms = 60000
servos = { 11 = { min_deg = 20.0, max_deg = 160.0 }, 63 = { max_deg = 90 } }
[watchdog]
timeout_ms = 20
scope = "robot"
repeats = 0
repeat_interval_ms = 1
landing_ms = 5000
landing = { 11 = 90 }
[lease]
required = true
ttl_ms = 200
[buttons]
required = 8
timeout_ms = 200
names = ["kitchen", "operator"]
[state]
path = "/mnt/state"
[telemetry]
frames = true
metrics = "127.0.0.1:9464"
[safety]
min_battery_v = 6.4
max_tilt_deg = 45
[power]
interface = "slcan"
channel = "/dev/ttyACM0"
servos = [63, 62, 61, 53, 52, 51, 43, 42, 41, 33, 32, 31, 23, 22, 21, 13, 12, 11]
confirm_ms = 200
[log]
level = "debug"
"""


UNLIKE = {("limits", "start_stagger_ms")}
"""Not together with elkapod-2025."""


def test_a_file_can_change_every_setting(file: Path) -> None:
    file.write_text(CHANGED)
    made, default = load(file), Settings()
    for section in Settings.model_fields:
        for name in type(getattr(made, section)).model_fields:
            changed = getattr(getattr(made, section), name) != getattr(getattr(default, section), name)
            assert changed is ((section, name) not in UNLIKE), name
    assert made.spi.framing is Framing.LENGTH_PREFIXED
    assert made.zenoh.listen == ("tls/0.0.0.0:7447", "tcp/127.0.0.1:7448")
    assert made.limits.servos == {"11": ServoLimits(min_deg=20, max_deg=160), "63": ServoLimits(max_deg=90)}
    assert made.spi.frame_gap_us == 20.5


def as_variables(values: dict[str, Any], prefix: str = "HEXAPOD") -> dict[str, str]:
    """The variables that say what `values` say."""
    made: dict[str, str] = {}
    for name, value in values.items():
        variable = f"{prefix}{'_' if prefix == 'HEXAPOD' else '__'}{name.upper()}"
        if isinstance(value, dict):
            made |= as_variables(value, variable)
        else:
            made[variable] = str(value).lower() if isinstance(value, bool) else str(value).replace("'", '"')
    return made


def test_the_environment_can_change_every_setting_too(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file.write_text(CHANGED)
    for variable, text in as_variables(tomllib.loads(CHANGED)).items():
        monkeypatch.setenv(variable, text)
    assert load() == load(file)
    file.write_text(in_toml(Settings()))
    assert load(file) == load()


def test_the_environment_overrides_the_file_value_by_value(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file.write_text('[spi]\ndevice = "/dev/a"\nspeed_hz = 7\n[zenoh]\nlisten = ["a"]\n[limits.servos.11]\nmin_deg = 5')
    monkeypatch.setenv("HEXAPOD_SPI__DEVICE", "/dev/b")
    monkeypatch.setenv("HEXAPOD_ZENOH__LISTEN", '["b", "c"]')
    monkeypatch.setenv("HEXAPOD_LIMITS__SERVOS__11__MAX_DEG", "6")
    made = load(file)
    assert (made.spi.device, made.spi.speed_hz) == ("/dev/b", 7)
    assert made.zenoh.listen == ("b", "c")
    assert made.limits.servos == {"11": ServoLimits(min_deg=5, max_deg=6)}


def test_the_default_file_is_read_if_it_exists(tmp_path: Path) -> None:
    assert load() == Settings()
    (tmp_path / "default.toml").write_text("[watchdog]\ntimeout_ms = 99\n")
    assert load().watchdog.timeout_ms == 99
    (tmp_path / "default.toml").write_text("[watchdog]\ntimeout_ms = 9\n")
    assert faults()[0].startswith(f"{tmp_path}/default.toml: watchdog.timeout_ms: 9 ")


def test_settings_are_frozen() -> None:
    with pytest.raises(ValidationError, match="frozen"):
        Settings().watchdog.timeout_ms = 10_000
    sections: list[BaseModel] = [getattr(Settings(), name) for name in Settings.model_fields]
    assert all(section.model_config["frozen"] for section in [*sections, ServoLimits()])


def test_the_clock_of_a_protocol_is_its_own_unless_set(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for protocol, speed_hz in (("hexapod-1.0", 2_500_000), ("elkapod-2025", 1_000_000)):
        file.write_text(f'[spi]\nprotocol = "{protocol}"\navoid_deg = [1.0, 4.0]\n')
        assert load(file).spi.speed_hz == speed_hz
        monkeypatch.setenv("HEXAPOD_SPI__PROTOCOL", protocol)
        assert load().spi.speed_hz == speed_hz
        monkeypatch.delenv("HEXAPOD_SPI__PROTOCOL")
        file.write_text(f'[spi]\nprotocol = "{protocol}"\nspeed_hz = 7\n')
        assert load(file).spi.speed_hz == 7


def test_the_other_protocol_has_no_framing(file: Path) -> None:
    """Nor the framing's angles that are not sent, nor its fastest clock."""
    file.write_text('[spi]\nprotocol = "elkapod-2025"\nframing = "length-prefixed"\nspeed_hz = 20_000_000\n')
    assert settings.load(file).spi.avoid_cdeg is None
    file.write_text('[spi]\nprotocol = "elkapod-2025"\n')
    assert settings.load(file).spi.protocol.spi_mode == 2


# ---- values out of range, or anything


RANGES: dict[str, tuple[float, float]] = {
    name.replace(".N.", ".32."): (json.loads(low), json.loads(high))
    for name, field in test_interface.settings().items()
    for low, separator, high in (test_interface.ends(field).partition(" to "),)
    if separator and name != "watchdog.landing.N"
}
"""What docs/interface.md states, as that test compares it."""


@pytest.mark.parametrize("place", RANGES)
def test_a_range_holds_at_both_ends(file: Path, monkeypatch: pytest.MonkeyPatch, place: str) -> None:
    low, high = RANGES[place]
    variable = f"HEXAPOD_{place.upper().replace('.', '__')}"
    protocol = "elkapod-2025" if place.startswith("safety.") else "hexapod-1.0"  # what only that one measures
    monkeypatch.setenv("HEXAPOD_SPI__PROTOCOL", protocol)
    for value in (low, high):
        file.write_text(f'spi.protocol = "{protocol}"\n{place} = {value}')
        load(file)
        monkeypatch.setenv(variable, str(value))
        assert load() == load(file)
        monkeypatch.delenv(variable)
    for value, limit in ((low - 1, f"greater than or equal to {low}"), (high + 1, f"less than or equal to {high}")):
        file.write_text(f'spi.protocol = "{protocol}"\n{place} = {value}')
        assert faults(file) == [f"file: {place}: {value} will not do: input should be {limit}"]
        monkeypatch.setenv(variable, str(value))
        assert faults() == [f'{variable}: "{value}" will not do: input should be {limit}']
        monkeypatch.delenv(variable)


def test_every_number_has_a_range_that_is_tested() -> None:
    numbers = {
        f"{section}.{name}"
        for section in Settings.model_fields
        for name, value in getattr(Settings(), section)
        if isinstance(value, int | float) and not isinstance(value, bool)
    }
    assert numbers | {f"limits.servos.32.{name}" for name in ServoLimits.model_fields} == RANGES.keys()


toml_values = st.recursive(
    st.one_of(st.booleans(), st.integers(), st.floats(), st.text(st.characters(codec="ascii", categories=["L", "N"]))),
    lambda inner: st.lists(inner, max_size=3),
    max_leaves=4,
)
PLACES = [f"{section}.{name}" for section in Settings.model_fields for name, _ in getattr(Settings(), section)]


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


def test_gateway_toml_says_the_defaults(tmp_path: Path) -> None:
    """The configuration that is installed changes nothing; each default in it is the true one, and none is left out."""
    installed = Path(__file__).parents[3] / "deploy/gateway.toml"
    assert settings.load(installed, simulated=True) == Settings()
    lines = [line for line in installed.read_text().splitlines() if "json5" not in line]  # the example of another
    uncommented = tmp_path / "gateway.toml"
    uncommented.write_text("\n".join(re.sub(r"^# (\w+ = |\[)", r"\1", line) for line in lines))
    spi = SpiSettings(avoid_deg=(1, 4))  # the default of one framing, which the file names
    assert spi.avoid_cdeg == SpiSettings(framing=Framing.LENGTH_PREFIXED).avoid_cdeg
    servo = ServoLimits(min_deg=20, max_deg=160)  # and the two examples that are no defaults
    limits = LimitSettings(servos={"11": servo})
    watchdog = WatchdogSettings(landing={"11": 90})
    expected = Settings(spi=spi, limits=limits, watchdog=watchdog)
    assert settings.load(uncommented).model_dump() == expected.model_dump()
    shown = {match[1] for line in lines if (match := re.match(r"# (\w+) = ", line))}
    sections = [*(getattr(Settings(), name) for name in Settings.model_fields if name != "power"), servo]
    tables = {"servos", "landing"}
    named = {name for section in sections for name in type(section).model_fields} - tables
    assert shown - {"11"} == named | set(PowerSettings.model_fields)


# ---- every fault of a file or the environment in one line that names its place; a framing that nobody has said


# ---- faults of the file


@pytest.mark.parametrize(("text", "line"), FILE_FAULTS, ids=lambda text: repr(text)[:50])
def test_a_fault_of_the_file(file: Path, text: str, line: str) -> None:
    file.write_text(text)
    assert faults(file) == [f"file: {line}"]


def test_each_fault_has_its_line(file: Path) -> None:
    file.write_text('y = 1\n[telemetry]\nframes = "no"\n[log]\nlevel = "loud"\n[spi]\nx = 1\n')
    assert [line.split(": ")[1] for line in faults(file)] == [
        "spi.x", "telemetry.frames", "log.level", "y"
    ]  # fmt: skip


NOT_TOML = {
    "no value": b"[spi]\nspeed_hz =",
    "a string without end": b'[spi]\ndevice = "',
    "a name given twice": b"[spi]\nspeed_hz = 1\nspeed_hz = 2",
    "Latin-1": '[spi]\ndevice = "Gerät"'.encode("latin-1"),
    "a byte order mark": b"\xef\xbb\xbf[spi]",
    "JSON": b'{"spi": {}}',
    "nothing but zeros": bytes(64),
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

        def reject(path: Path, *_: object) -> str:
            raise PermissionError(13, "Permission denied", str(path))

        monkeypatch.setattr(Path, "open", reject)
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


def test_a_pose_in_the_file_that_limits_in_the_environment_forbid(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file.write_text("[watchdog.landing]\n11 = 110")
    monkeypatch.setenv("HEXAPOD_LIMITS__SERVOS__11__MAX_DEG", "100")
    assert faults(file) == ["watchdog.landing.11: 110 will not do: limits.servos.11 allows 0 to 100"]
    monkeypatch.setenv("HEXAPOD_WATCHDOG__LANDING__11", "101")
    assert faults(file) == ["HEXAPOD_WATCHDOG__LANDING__11: 101 will not do: limits.servos.11 allows 0 to 100"]


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
        unset, *wanted = str(raised.value).splitlines()
        assert unset.startswith(f"{file}: spi.framing: is not set")
        assert "reset" in unset
        assert wanted == [f'{file}: spi.framing: {framing.controller} needs "{framing}"' for framing in Framing]
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
        "spi.speed_hz", "spi.framing", "spi.framing", "spi.framing"
    ]  # fmt: skip


@pytest.mark.parametrize("text", ["[", "spi = 3", '[spi]\nframing = "Plain"'])
def test_what_cannot_be_read_is_told_for_itself(file: Path, text: str) -> None:
    file.write_text(text)
    with pytest.raises(ConfigError) as raised:
        framing_of(file)
    assert str(raised.value).splitlines() == [line.replace("file", str(file), 1) for line in faults(file)]


@pytest.mark.parametrize(
    ("text", "lines"),
    [
        ("[calibration]\n[recorder]\n", []),  # as an earlier version installed it, without a change
        (
            '[calibration]\npath = "/mnt/own.toml"\n',
            ["file: calibration: was removed; name its folder with state.path, which has all that outlasts the gateway "
             "(the calibration as calibration.toml)"],
        ),
        (
            '[recorder]\npath = "/mnt/box"\n',
            ["file: recorder: was removed; name its folder with state.path, which has all that outlasts the gateway "
             "(the black box keeps 60 s)"],
        ),
        (
            '[telemetry]\nstate_hz = 5\n[lease]\ntakeover = "never"\n',
            [
                "file: lease.takeover: was removed; everybody may take the lease, which stops all legs first",
                "file: telemetry.state_hz: was removed; the state comes ten times a second",
            ],
        ),
    ],
)  # fmt: skip
def test_a_removed_setting_names_what_takes_its_place(tmp_path: Path, text: str, lines: list[str]) -> None:
    path = tmp_path / "gateway.toml"
    path.write_text(text)
    if lines:
        assert faults(path) == lines
    else:
        assert load(path) == Settings()


def test_a_variable_of_a_removed_setting_names_it_too(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HEXAPOD_CALIBRATION__PATH", "/mnt/own.toml")
    monkeypatch.setenv("HEXAPOD_RECORDER__PATH", "/mnt/box")
    for line, variable in zip(faults(), ("HEXAPOD_CALIBRATION__PATH", "HEXAPOD_RECORDER__PATH"), strict=True):
        assert line.startswith(f"{variable}: was removed; name its folder with state.path")
