"""Makes docs/physics-walking.png and docs/physics-fallen.png anew: `python -m tests.console.fall_picture`."""

import re
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from playwright.sync_api import ViewportSize, expect

from gateway.client import Client
from schemas.keys import SIM_BODY
from schemas.telemetry import BodyReport
from tests.console.browser import Opened
from tests.console.picture import looked_at
from tests.console.test_fall import PATIENT, STEEP, push_over
from tests.support.gateway_process import Gateway
from tests.support.heard import Heard

DOCS: Final = Path(__file__).parents[2] / "docs"
STILL_M_S: Final = 0.01
SIZE: Final[ViewportSize] = {"width": 980, "height": 560}
WEAK: Final = ("--sim=physics", "--mass-kg", "8", "--servo-torque-nm", "1.4")
"""Too heavy for its servos: it walks on its belly."""


@contextmanager
def simulated(options: tuple[str, ...]) -> Iterator[tuple[Opened, Client]]:
    """A page on a robot that is simulated so."""
    with (
        tempfile.TemporaryDirectory() as name,
        Gateway(Path(name), PATIENT, options=options) as gateway,
        looked_at(gateway.endpoint, size=SIZE) as page,
        gateway.client() as client,
    ):
        expect(page["see-title"]).to_have_text("Where it is")
        yield page, client


def take(page: Opened, name: str) -> None:
    page.page.locator("section.see").screenshot(path=DOCS / name)


def main() -> None:
    with simulated(WEAK) as (page, client), client.walk() as walk:
        walk.stand()
        for _ in range(100):
            walk.go(0.05)
        take(page, "physics-walking.png")
    with simulated(STEEP) as (page, client):
        heard = Heard(client, SIM_BODY, BodyReport)
        push_over(client)
        heard.wait(lambda body: not body.upright and max(map(abs, body.velocity_m_s)) < STILL_M_S, timeout_s=30)
        expect(page["sim-known"]).to_have_text(re.compile("on its back"))
        take(page, "physics-fallen.png")


if __name__ == "__main__":
    main()
