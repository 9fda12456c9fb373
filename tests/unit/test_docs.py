"""What README, CONTRIBUTING and docs/ name exists: files, tests, links, headings; and the docs site is whole."""

import re
import sys
from pathlib import Path
from typing import Final

import pytest

import gateway.client
from tests.support.command import run_program

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md")), *ROOT.glob("*/README.md")]
FOLDERS = ("gateway", "schemas", "tests", "docs", "deploy", "examples")
ROOMS = tuple(
    sorted(path.name for parent in ("gateway", "tests") for path in (ROOT / parent).iterdir() if path.is_dir())
)
"""In prose, gateway/robot/core/legs.py is `robot/core/legs.py`, and tests/hil/test_load.py `hil/test_load.py`."""


def named(page: str) -> set[str]:
    """Return a page's paths in backticks, or as a whole word that begins with a folder of this repository."""
    prose = re.sub(r"```.*?```", "", page, flags=re.DOTALL)
    quoted = [word for code in re.findall(r"`([^`\n]+)`", prose) for word in code.split()]
    words = [word.strip("`()[],;:.") for word in page.split()]
    found = {word for word in words if word.startswith(tuple(f"{folder}/" for folder in FOLDERS))}
    found |= {word for word in quoted if re.fullmatch(r"[\w./-]+\.(py|md|sh|toml|json5?|service)", word)}
    found |= {word for word in quoted if word.startswith(tuple(f"{room}/" for room in ROOMS))}
    return {path for path in found if re.fullmatch(r"[\w.][\w./-]*", path)} - MADE_ELSEWHERE


MADE_ELSEWHERE = frozenset(
    {"gateway.toml", "calibration.toml", "anna.json5", "ros2.json5", "NAME.json5", "NAME.robot-2.json5", "estop.json"}
)
"""Files of the reader's own, which the pages tell how to make or fill."""


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_the_files_that_a_page_names_exist(page: Path) -> None:
    """From the root, or inside `gateway/` or `tests/`."""
    parents = (ROOT, ROOT / "gateway", ROOT / "tests")
    assert {path for path in named(page.read_text()) if not any((each / path).exists() for each in parents)} == set()


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page: Path) -> None:
    for link in re.findall(r"\]\(([^)]+)\)", page.read_text()):
        path, _, heading = link.partition("#")
        if "://" in path:
            continue
        target = page.parent / path if path else page
        assert target.exists(), link
        assert not heading or heading in headings(target), link


def headings(page: Path) -> set[str]:
    """Return headings as GitHub makes them: lower case, no punctuation, spaces as hyphens."""
    lines = re.findall(r"^#+ (.*)$", page.read_text(), re.MULTILINE)
    return {re.sub(r"[^\w -]", "", line.lower()).replace(" ", "-") for line in lines}


README = ROOT.joinpath("README.md").read_text()


def test_readmes_first_screen_has_its_two_commands() -> None:
    """`make run` and `make test`, each a line to copy, and each a target of the Makefile."""
    first_screen = README.splitlines()[:25]
    targets = re.findall(r"^(\w+):", ROOT.joinpath("Makefile").read_text(), re.MULTILINE)
    for target in ("run", "test"):
        assert [line for line in first_screen if re.match(rf"\$ make {target}\b", line)], f"no `make {target}`"
        assert target in targets


def test_readmes_commands_come_behind_the_line_that_puts_them_on_the_path() -> None:
    activated = README.index("$ source .venv/bin/activate\n")
    first = re.search(r"(\$ |`)(hexapod-gateway [a-z]|python )", README)
    assert first is not None
    assert first.start() > activated
    assert "`.venv/bin/" not in README, "one way to name a command"


SITE: Final = ROOT / "build/docs"
RETURNED: Final = {"Ack", "Event", "GatewayState", "Kind", "Odometry", "Posture", "Reason", "Telemetry", "WalkState"}
OURS: Final = {"Button.leave", "Client.carry", "Lease.token", "Odometry.after", "Stream.send", "Walk.end_now"}
PROGRAMS: Final = {"AsyncClient.lease", "AsyncWalk.go", "Ack.or_raise", "Stream.recover", "Event.kind", "Walk.turn"}


@pytest.fixture(scope="module")
def client_page() -> str:
    """Build the site, and return its page of `gateway.client`."""
    build = ("zensical", "build", "--strict", "--clean", "--config-file", "mkdocs.yml")
    run_program(sys.executable, "-m", *build, cwd=ROOT)
    return (SITE / "api" / "client.html").read_text(encoding="utf-8")


@pytest.mark.full
def test_the_site_shows_what_programs_use_and_nothing_of_our_own(client_page: str) -> None:
    shown = {name.removeprefix("gateway.client.") for name in re.findall(r'<h\d id="([\w.]+)"', client_page)}
    assert shown >= {*gateway.client.__all__} | RETURNED | PROGRAMS
    assert not OURS & shown
    assert not {name for name in shown if name.endswith("exit_code")}


@pytest.mark.full
def test_methods_made_at_import_have_their_signature_and_are_async(client_page: str) -> None:
    shown, _, _ = client_page.partition('id="gateway.client.AsyncWalk.go"')[2].partition("<h")
    assert "doc-label-async" in shown
    assert "forward_m_s" in shown


@pytest.mark.full
@pytest.mark.usefixtures("client_page")
def test_each_page_is_in_the_menu_and_in_the_search() -> None:
    pages = {path.relative_to(ROOT / "docs").as_posix() for path in (ROOT / "docs").rglob("*.md")}
    menu = re.findall(r": (\S+\.md)$", (ROOT / "mkdocs.yml").read_text(encoding="utf-8"), re.MULTILINE)
    search = (SITE / "search.json").read_text(encoding="utf-8")
    assert set(menu) == pages
    assert {page for page in pages if f'"{page.removesuffix(".md")}.html' not in search} == set()
