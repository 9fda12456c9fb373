"""Examples: the plug-in for a Pololu Maestro, on an emulated serial port."""

import importlib.util
import os
import pty
import threading
import tty
from collections.abc import Iterator
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

import pytest

from gateway.host import settings_table
from gateway.onboard.check import conformance
from gateway.wire import ServoWire
from tests.support.closing import Closing

FILE = Path(__file__).parents[2] / "examples" / "wire_maestro" / "wire_maestro.py"


class Maestro(Closing):
    """Takes Set Target and Get Errors of the compact protocol, as the user's guide has them (chapter 5.e)."""

    def __init__(self) -> None:
        self._ours, self._theirs = pty.openpty()
        tty.setraw(self._theirs)
        self.path = os.ttyname(self._theirs)
        self.targets: dict[int, int] = {}
        self.errors = b"\0\0"
        threading.Thread(target=self._run, daemon=True).start()

    def close(self) -> None:
        os.close(self._theirs)

    def _run(self) -> None:
        with suppress(OSError), open(self._ours, "r+b", buffering=0) as port:  # closed
            while command := port.read(1):
                if command == b"\xa1":
                    port.write(self.errors)
                else:
                    assert command == b"\x84", command
                    channel, low, high = (port.read(1)[0] for _ in range(3))
                    self.targets[channel] = low | high << 7


@pytest.fixture
def board() -> Iterator[Maestro]:
    with Maestro() as running:
        yield running


@pytest.fixture(scope="module")
def kind() -> Any:
    spec = importlib.util.spec_from_file_location("wire_maestro", FILE)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.Maestro


def test_angles_are_quarters_of_a_microsecond_and_a_stop_is_0(board: Maestro, kind: type[ServoWire]) -> None:
    wire = kind({"path": board.path, "channels": [*range(17), 23]})
    wire.open()
    with closing(wire):
        wire.apply([(11, 0.0), (12, 90.0), (63, 180.0)])
        assert board.targets == {0: 2000, 1: 6000, 23: 10_000}
        wire.apply([(12, None)])
        assert board.targets == {0: 2000, 1: 0, 23: 10_000}


@pytest.mark.parametrize(("errors", "sentence"), [(b"\x10\0", "the Maestro reports 1000"), (b"", "does not answer")])
def test_an_error_and_no_answer_are_faults(board: Maestro, kind: type[ServoWire], errors: bytes, sentence: str) -> None:
    board.errors = errors
    wire = kind({"path": board.path})
    wire.open()
    with closing(wire), pytest.raises(OSError, match=sentence):
        wire.apply([(11, None)])


def test_it_keeps_the_contract_of_a_wire(
    board: Maestro,
    kind: type[ServoWire],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(conformance, "_HOLD_S", 0)
    monkeypatch.setattr(settings_table, "load_plugin", lambda _name, options: kind(options))
    file = tmp_path / "gateway.toml"
    file.write_text(f'[wire]\nname = "maestro"\npath = "{board.path}"')
    assert conformance.conformance(file, agreed=True, unplug=False) == 0, capsys.readouterr().out


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"speed": 1}, "speed is not an option"),
        ({"path": 5}, "path: write the port"),
        ({"channels": [0] * 18}, "18 different whole numbers"),
        ({"pulse_us": [500, 3000]}, "300 to 2700"),
    ],
)
def test_wrong_options_are_a_sentence(kind: type[ServoWire], change: dict[str, object], sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        kind({"path": "/dev/ttyACM0", **change})
