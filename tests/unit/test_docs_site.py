"""The docs site: no link is broken, and its API pages show what a program uses, and nothing that only we use."""

import re
import subprocess
import sys
from pathlib import Path
from typing import Final

import pytest

import gateway.client

ROOT: Final = Path(__file__).resolve().parents[2]
SITE: Final = ROOT / "build/docs"
RETURNED: Final = {"Ack", "Event", "GatewayState", "Kind", "Odometry", "Posture", "Reason", "Telemetry", "WalkState"}
OURS: Final = {"Button.leave", "Client.carry", "Lease.token", "Odometry.after", "Stream.send", "Walk.end_now"}
PROGRAMS: Final = {"AsyncClient.lease", "AsyncWalk.go", "Ack.or_raise", "Stream.recover", "Event.kind", "Walk.turn"}

pytestmark = pytest.mark.full


@pytest.fixture(scope="module")
def shown() -> set[str]:
    """The names on the page of `gateway.client`, of the site as `make docs` builds it."""
    built = subprocess.run(
        [sys.executable, "-m", "zensical", "build", "--strict", "--clean", "--config-file", "mkdocs.yml"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert built.returncode == 0, built.stdout + built.stderr
    page = (SITE / "api" / "client.html").read_text(encoding="utf-8")
    return {name.removeprefix("gateway.client.") for name in re.findall(r'<h\d id="([\w.]+)"', page)}


def test_what_methods_return_is_exported_and_shown(shown: set[str]) -> None:
    assert set(gateway.client.__all__) <= shown
    assert shown >= RETURNED


def test_methods_of_our_own_are_not_shown_and_those_of_programs_are(shown: set[str]) -> None:
    assert not OURS & shown
    assert shown >= PROGRAMS
    assert not {name for name in shown if name.endswith("exit_code")}


@pytest.mark.usefixtures("shown")
def test_methods_made_at_import_have_their_signature_and_are_async() -> None:
    page = (SITE / "api" / "client.html").read_text(encoding="utf-8")
    _, _, method = page.partition('id="gateway.client.AsyncWalk.go"')
    shown, _, _ = method.partition("<h")
    assert "doc-label-async" in shown
    assert "forward_m_s" in shown


@pytest.mark.usefixtures("shown")
def test_each_page_is_in_the_menu_and_in_the_search() -> None:
    pages = {path.relative_to(ROOT / "docs").as_posix() for path in (ROOT / "docs").rglob("*.md")}
    menu = re.findall(r": (\S+\.md)$", (ROOT / "mkdocs.yml").read_text(encoding="utf-8"), re.MULTILINE)
    search = (SITE / "search.json").read_text(encoding="utf-8")
    assert set(menu) == pages
    assert {page for page in pages if f'"{page.removesuffix(".md")}.html' not in search} == set()
