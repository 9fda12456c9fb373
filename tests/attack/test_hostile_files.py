"""A file that nests without end is a sentence with its name, and never a signal or a traceback."""

from pathlib import Path
from typing import Final

import pytest

from tests.support.child import Child
from tests.support.gateway_process import COMMAND

JSON5: Final = "[" * 100_000
KEY: Final = "a" + ".a" * 20_000 + "=1"

READ: Final = {
    "a client's Zenoh file": ("client.json5", JSON5, ("stop", "--zenoh-config", "{file}"), 2),
    "the service's": ("gateway.json5", JSON5, ("run", "--sim", "--config", "{settings}"), 2),
    "settings, a long key": ("settings.toml", KEY, ("run", "--sim", "--config", "{file}"), 2),
    "settings, by stop-servos": ("settings.toml", KEY, ("stop-servos", "--config", "{file}"), 2),
    "a geometry": ("geometry.json", JSON5, ("record", "out.mcap", "--geometry", "{file}"), 2),
}
"""The file's name, what is in it, the command that reads it, and its exit code."""


@pytest.mark.parametrize("case", READ)
def test_a_hostile_file_is_a_sentence_with_its_name(case: str, tmp_path: Path) -> None:
    name, text, command, code = READ[case]
    file, settings = tmp_path / name, tmp_path / "gateway.toml"
    file.write_text(text)
    settings.write_text(f'[zenoh]\nconfig = "{file}"\n[spi]\nframing = "plain"\n')
    with Child([*COMMAND, *(each.format(file=file, settings=settings) for each in command)], {}) as child:
        assert child.wait(30) == code, str(child)
    assert "Traceback" not in child.stderr
    assert name in child.stdout + child.stderr
