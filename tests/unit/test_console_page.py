"""The console's page: whole, without a line that its Content-Security-Policy forbids, three.js as it was published."""

import re
from hashlib import sha256
from pathlib import Path
from typing import Final

import pytest

PAGE: Final = Path(__file__).parents[2] / "gateway/people/console/page"
HTML: Final = (PAGE / "index.html").read_text()
BUTTON: Final = (PAGE / "button.html").read_text()
"""The page that is a stop button."""
MODULES: Final = sorted(PAGE.glob("*.js"))

THREE_0_187_0: Final = {
    "three.module.js": "104f56145899722094556490d787aae0617cc2fc3382f31df02d724ea1aee341",
    "three.core.js": "613e370f76638fdef83926642bf256dc9615684922de1ce1f63a8583e5d78578",
}
"""SHA-256 of the files in npm's package three 0.187.0."""


def test_every_file_that_the_page_names_is_there() -> None:
    named = re.findall(r'(?:src|href)="([^"./][^"]+)"', HTML + BUTTON)
    assert {"main.js", "button.js", "button.css"} <= {*named}
    named.remove("button")  # a page of its own
    for module in MODULES:
        named += [f"{module.parent.relative_to(PAGE)}/{path}" for path in _imports(module.read_text())]
    for path in named:
        assert (PAGE / path).is_file(), path


def test_nothing_in_the_page_is_inline_or_from_elsewhere() -> None:
    assert not re.search(r"<script(?![^>]* src=)|<style|\sstyle=|\son\w+=", HTML + BUTTON)
    for text in (HTML, BUTTON, *(module.read_text() for module in MODULES)):
        assert not [address for address in re.findall(r"\bhttps?://[^\s\"']+", text) if "www.w3.org" not in address]


@pytest.mark.parametrize("module", MODULES, ids=lambda module: module.name)
def test_every_element_that_a_module_wants_is_on_the_page(module: Path) -> None:
    for name in re.findall(r'byId\("([^"]+)"', module.read_text()):
        assert f'id="{name}"' in (BUTTON if module.name == "button.js" else HTML), name


def test_three_is_as_it_was_published_with_its_licence() -> None:
    vendor = PAGE / "vendor" / "three"
    assert "MIT License" in (vendor / "LICENSE").read_text()
    assert {name: sha256((vendor / name).read_bytes()).hexdigest() for name in THREE_0_187_0} == THREE_0_187_0


def _imports(module: str) -> list[str]:
    return re.findall(r'(?:from|import\() ?"(\.[^"]+)"', module)
