"""A gait of one's own is one line in one file: page, terminal, bridge and walk have it."""

import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).parents[2]
_LINE: Final = '    "amble": Gait(2.00, 0.75, (0 / 4, 2 / 4, 1 / 4, 3 / 4, 2 / 4, 0 / 4)),\n'
_ASKS: Final = """
import json, os
from gateway.geometry import load
from gateway.people.bridge import topics
from gateway.people.console.messages import Hello, WalkWish
from gateway.people.tools.walk import screen
from gateway.people.walking import STILL, Engine, Posture, Robot, Velocity
from gateway.people.walking.gaits import __file__ as file

engine = Engine(Robot(load()), "amble")
engine.stand()
while engine.posture is not Posture.STANDING:
    engine.step(STILL, 0.02)
for _ in range(250):
    engine.step(Velocity(0.03), 0.02)
print(json.dumps({
    "file": file,
    "page": Hello.model_fields["gaits"].default,
    "page's wish": WalkWish.model_validate({"type": "walk", "press": 1, "id": 1, "sent_ms": 0, "gait": "amble"}).gait,
    "keys": screen._GAITS,
    "keys' help": screen._KEYS,
    "bridge": topics.NUMBERS,
    "went_m": engine.odometry.x_m,
}))
"""


def test_a_line_in_gaits_py_is_a_gait_on_the_page_in_the_terminal_and_on_the_bridge(tmp_path: Path) -> None:
    for package in ("gateway", "schemas"):
        shutil.copytree(ROOT / package, tmp_path / package, ignore=shutil.ignore_patterns("__pycache__"))
    table = tmp_path / "gateway" / "people" / "walking" / "gaits.py"
    before = table.read_text()
    head, wave, rest = before.partition('    "wave":')
    table.write_text(head + _LINE + wave + rest)
    asked = subprocess.run(
        [sys.executable, "-c", _ASKS],
        check=False,
        cwd=tmp_path,
        env={"PYTHONPATH": str(tmp_path)},
        capture_output=True,
        text=True,
    )
    assert asked.returncode == 0, asked.stderr
    found = json.loads(asked.stdout)
    assert found["file"] == str(table)
    assert found["page"] == ["tripod", "ripple", "amble", "wave"]
    assert found["page's wish"] == "amble"
    assert found["keys"] == {"1": "tripod", "2": "ripple", "3": "amble", "4": "wave"}
    assert "1 2 3 4   tripod, ripple, amble, wave" in found["keys' help"]
    assert found["bridge"] == {"0": "wave", "1": "ripple", "2": "tripod", "3": "amble"}
    assert found["went_m"] > 0.1
