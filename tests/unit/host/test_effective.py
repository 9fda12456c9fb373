"""What the service in fact uses: written at its start, read by `stop-servos` and `check`, judged by its process."""

import json
import os
from pathlib import Path

import pytest

from gateway.host import effective
from gateway.host.settings_reader import ForStops
from gateway.model.frames import Framing
from gateway.robot.settings import Settings

USED = Settings.of(
    {
        "spi": {"framing": "length-prefixed", "device": '/dev/spi"dev1.0', "speed_hz": 500_000, "frame_gap_us": 60.5},
        "controller": {"uart": "/dev/ttyS0"},
        "power": {"interface": "slcan", "channel": "/dev/ttyACM0"},
    }
)


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The service's runtime directory."""
    monkeypatch.setenv("RUNTIME_DIRECTORY", str(tmp_path))
    monkeypatch.delenv("INVOCATION_ID", raising=False)
    return tmp_path


def test_without_a_runtime_directory_nothing_is_written(monkeypatch: pytest.MonkeyPatch, folder: Path) -> None:
    monkeypatch.delenv("RUNTIME_DIRECTORY")
    effective.write(ForStops(USED.wire, USED.spi, USED.controller, USED.power))
    assert list(folder.iterdir()) == []


def test_a_process_that_ended_and_one_that_has_its_number(folder: Path) -> None:
    """A number alone shows nothing: the kernel gives it again."""
    effective.write(ForStops(USED.wire, USED.spi, USED.controller, USED.power))
    written = json.loads((folder / effective.NAME).read_text())
    beyond = 2**22 + 1  # which the kernel gives to none
    for others in ({"process": beyond}, {"begun": 1}):
        (folder / effective.NAME).write_text(json.dumps(written | others))
        found = effective.read()
        assert found is not None
        assert not found.runs


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"\xff",
        b"[]",
        b"[" * 5000,
        b'{"spi": 3}',
        b'{"spi": {"framing": "Plain"}}',
        b'{"spi": {"framing": "plain", "speed_hz": 0}}',
    ],
)
def test_a_damaged_file_says_nothing(folder: Path, content: bytes) -> None:
    assert effective.read() is None
    (folder / effective.NAME).write_bytes(content)
    assert effective.read() is None


def test_where_a_file_differs(folder: Path) -> None:
    effective.write(ForStops(USED.wire, USED.spi, USED.controller, USED.power))
    found = effective.read()
    assert found is not None
    file = folder / "gateway.toml"
    rest = 'device = "/dev/spi\\"dev1.0"\nspeed_hz = 500_000\nframe_gap_us = 60.5\n'
    uart = "[controller]\nuart = '/dev/ttyS0'\n"
    uart += "[power]\ninterface = 'slcan'\nchannel = '/dev/ttyACM0'\n"
    file.write_text(f'[spi]\nframing = "length-prefixed"\n{rest}{uart}')
    assert effective.differences(found, file) == []
    assert found == effective.running()
    file.write_text(f'[spi]\nframing = "plain"\nspeed_hz = 500_000\n{uart}')
    assert effective.differences(found, file) == [
        f'{file} has spi.framing = "plain", and the service uses "length-prefixed"',
        f'{file} has spi.device = "/dev/spidev0.0", and the service uses "/dev/spi\\"dev1.0"',
        f"{file} has spi.frame_gap_us = 50.0, and the service uses 60.5",
    ]
    for text in ("spi = 3\n", "no TOML"):
        file.write_text(text)
        assert Framing.LENGTH_PREFIXED in effective.differences(found, file)[0]
    os.mkfifo(folder / "FIFO")
    for name in ("none", "FIFO"):
        assert "cannot be read" in effective.differences(found, folder / name)[0]
