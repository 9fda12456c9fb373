"""The console's page: whole, without a line that its Content-Security-Policy forbids, three.js as it was made."""

import re
from hashlib import sha256
from pathlib import Path
from typing import Final

import pytest
from multidict import CIMultiDict

from gateway.people.console.server.auth import read_files

PAGE: Final = Path(__file__).parents[2] / "gateway/people/console/page"
HTML: Final = (PAGE / "index.html").read_text()
BUTTON: Final = (PAGE / "button.html").read_text()
"""The page that is a stop button."""
MODULES: Final = sorted(PAGE.glob("*.js"))

THREE_0_187_0: Final = "d12e651b7b45cc9a16d5bebd26301664597b376c2a1e3002cbf3a65f69fab5be"
"""SHA-256 of what `make three` makes of npm's package three 0.187.0."""


def test_every_file_that_the_page_names_is_there() -> None:
    named = re.findall(r'(?:src|href)="([^"./][^"]+)"', HTML + BUTTON)
    assert {"main.js", "button.js", "button.css"} <= {*named}
    named.remove("button")  # a page of its own
    for module in MODULES:
        imports = re.findall(r'(?:from|import\() ?"(\.[^"]+)"', module.read_text())
        named += [f"{module.parent.relative_to(PAGE)}/{path}" for path in imports]
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


def test_three_is_as_it_was_made_with_its_licence_and_has_what_the_page_uses() -> None:
    vendor = PAGE / "vendor" / "three"
    assert "MIT License" in (vendor / "LICENSE").read_text()
    made = (vendor / "three.js").read_bytes()
    assert sha256(made).hexdigest() == THREE_0_187_0, "make three"
    exported = set(re.findall(r" as (\w+)[,}]", made.decode().rpartition("export{")[2]))
    used = {name for module in MODULES for name in re.findall(r"\bthree\.([A-Z]\w+)", module.read_text())}
    assert exported == used, "make three"


def test_a_phone_loads_at_most_300_kb() -> None:
    """All files, the 3D part too, packed; headers come on top."""
    answers = [file.response(CIMultiDict({"Accept-Encoding": "gzip"})) for file in read_files().values()]
    assert sum(len(answer.body) for answer in answers if isinstance(answer.body, bytes)) in range(100_000, 300_000)
