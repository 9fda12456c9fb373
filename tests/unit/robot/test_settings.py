"""Settings from a file and the environment: defaults, what overrides what, ranges, and what is said of faults."""

import json
import re
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from gateway.errors import ConfigError
from gateway.host.settings_table import (
    LimitSettings,
    ServoLimits,
    WatchdogSettings,
)
from gateway.model.framing import Framing
from gateway.robot import settings
from gateway.robot.settings import FramingNotSetError, Settings
from release import settings_page
from tests.support.bad_settings import ENVIRONMENT_FAULTS, FILE_FAULTS
from tests.support.settings_file import faults, load

pytestmark = pytest.mark.usefixtures("_clean_environment")

# ---- where settings come from


def in_toml(made: Settings) -> str:
    """A file that has each setting, as it is."""
    sections = json.loads(json.dumps(asdict(made)))
    del sections["wire"]["options"]
    return "".join(
        f"{section}.{name} = {_toml(value)}\n" for section in sections for name, value in sections[section].items()
    )


def test_the_defaults_may_be_written_down(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Which they are is in docs/interface.md (tests/unit/test_interface.py)."""
    file.write_text(in_toml(Settings()))
    monkeypatch.setenv("HEXAPOD_CONNECT", "tcp/192.0.2.7:7447")  # for client commands, and no setting
    assert load(file) == load() == Settings()


# ---- values out of range, or anything


RANGES: dict[str, tuple[float, float]] = {
    name.replace(".N.", ".32."): setting.allowed.limits
    for name, setting in settings_page.settings().items()
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
        assert faults() == [f'{variable}: "{value}" is not allowed: input should be {limit}']
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


def test_gateway_toml_says_the_defaults(tmp_path: Path) -> None:
    """The configuration that is installed changes nothing; each default in it is the true one, and none is left out."""
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


def test_each_fault_has_its_line(file: Path) -> None:
    file.write_text('y = 1\n[telemetry]\nframes = "no"\n[watchdog]\nscope = "loud"\n[spi]\nx = 1\n')
    assert [line.split(": ")[1] for line in faults(file)] == [
        "spi.x", "watchdog.scope", "telemetry.frames", "y"
    ]  # fmt: skip


def test_a_file_that_is_none(file: Path, tmp_path: Path) -> None:
    assert faults(file) == ["file: there is no such file; name another with --config"]
    assert faults(tmp_path) == ["file: cannot be read (Is a directory); name another file with --config"]


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
    with pytest.raises(FramingNotSetError, match=r"default\.toml: spi.framing: is not set"):
        framing_of(None)
    for framing in Framing:
        file.write_text(f'[spi]\nframing = "{framing}"\n')
        assert framing_of(file) is load(file).spi.framing is framing
        file.write_text("")
        monkeypatch.setenv("HEXAPOD_SPI__FRAMING", framing)
        assert framing_of(file) is framing_of(None) is framing
        monkeypatch.delenv("HEXAPOD_SPI__FRAMING")


@pytest.mark.parametrize(
    ("text", "lines"),
    [
        ("[calibration]\n[recorder]\n", []),  # as an earlier version installed it, without a change
        (
            '[calibration]\npath = "/mnt/own.toml"\n',
            ["file: calibration: was removed; name its folder with state.path, the folder for all kept state "
             "(the calibration as calibration.toml)"],
        ),
        (
            '[recorder]\npath = "/mnt/box"\n',
            ["file: recorder: was removed; name its folder with state.path, the folder for all kept state "
             "(the black box keeps 60 s)"],
        ),
        (
            '[telemetry]\nstate_hz = 5\n[lease]\ntakeover = "never"\n',
            [
                "file: lease.takeover: was removed; everybody may take the lease, which stops all legs first",
                "file: telemetry.state_hz: was removed; the state is published ten times a second",
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
