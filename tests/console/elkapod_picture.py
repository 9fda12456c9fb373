"""Makes examples/elkapod/walking.png anew: `python -m tests.console.elkapod_picture`."""

import os
import re
import shutil
import sys
import tempfile
from pathlib import Path
from typing import Final

from playwright.sync_api import expect

from gateway.client import Client
from schemas.telemetry import Cause
from tests.console.picture import looked_at
from tests.support.child import Child
from tests.support.gateway_process import COMMAND, READY, free_port
from tests.support.heard import frames

ELKAPOD: Final = Path(__file__).parents[2] / "examples" / "elkapod"
FRAMES: Final = re.compile(r"^(2[5-9]|3[0-9])\d")
"""Hundreds a second, once the page has counted for a while: six legs at 50 Hz are 300."""
STANDS: Final = 1000
"""Frames of commands after which it has stood up, and walks."""


def main() -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with tempfile.TemporaryDirectory() as name:
        shutil.copy(ELKAPOD / "calibration.toml", name)
        env = {
            **os.environ,
            "HEXAPOD_ZENOH__LISTEN": f'["{endpoint}"]',
            "HEXAPOD_STATE__PATH": name,
        }
        gateway = Child([*COMMAND, "run", "--sim", "--config", str(ELKAPOD / "gateway.toml")], env)
        gateway.wait_for_output(READY)
        with (
            looked_at(endpoint, "--geometry", str(ELKAPOD / "geometry.json")) as page,
            Client(endpoint, source="picture") as client,
        ):
            written = frames(client)
            gait = Child([sys.executable, str(ELKAPOD / "gait.py"), "--connect", endpoint], env)
            page.expect_status(6, "runs")
            expect(page["number-frames"]).to_have_text(FRAMES)
            written.wait(lambda record: record.cause is Cause.COMMAND, count=STANDS, timeout_s=30)
            page.page.screenshot(path=ELKAPOD / "walking.png")
            gait.close()
        gateway.close()


if __name__ == "__main__":
    main()
