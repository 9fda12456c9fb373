"""The docs site: `python -m release.docs_site` builds it in build/docs, and ends with 1 where a link leads nowhere.

GitHub shows the same pages from where they stand: some in docs/, README, CONTRIBUTING and the examples elsewhere, with
links to files of the repository. Here they come together in one folder, with each file that a page links to, so the
site can be read without the repository.
"""

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from copy import copy
from html.parser import HTMLParser
from importlib import import_module
from inspect import iscoroutinefunction, isfunction
from pathlib import Path, PurePosixPath
from typing import Any, Final
from urllib.parse import unquote, urlsplit

import griffe

ROOT: Final = Path(__file__).resolve().parents[1]
OUTSIDE: Final = {
    "README.md": "index.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
    "examples/README.md": "examples/index.md",
    "examples/elkapod/README.md": "examples/elkapod.md",
}
"""Pages that stand outside docs/, and where the site has them."""
FOLDERS: Final = {"examples": "examples/index.md", "schemas/json": "api/schemas.md"}
"""Folders that pages link to, and the page that stands for each."""
SHOWN: Final = {".json", ".png", ".svg", ".webp"}
"""Files that a browser opens as they are; all others get `.txt` behind their names."""

DOCTEST: Final = re.compile(r"^>>> .*(?:\n.+)*", re.MULTILINE)
LINK: Final = re.compile(r"(\]\()([^)#\s]+)(#[^)\s]*)?(\))")

PAGES: Final = ROOT / "build" / "pages"
SITE: Final = ROOT / "build" / "docs"
"""As mkdocs.yml has them."""


def slug(heading: str, separator: str) -> str:
    """A heading's anchor as GitHub makes it, so that a link holds here and there."""
    return re.sub(r"[^\w -]", "", heading.lower()).replace(" ", separator)


def main() -> None:
    """Builds the site; ends with 1, and the list of what is broken, unless every link leads somewhere."""
    collect(PAGES)
    shutil.rmtree(SITE, ignore_errors=True)
    builder = [
        sys.executable,
        "-m",
        "zensical",
        "build",
        "--strict",
        "--clean",
        "--config-file",
        str(ROOT / "mkdocs.yml"),
    ]
    if subprocess.run(builder, cwd=ROOT, check=False).returncode:
        sys.exit(1)
    if broken := broken_links(SITE):
        sys.exit("These lead nowhere, or load from another host:\n" + "\n".join(broken))
    index = SITE / "search.json"
    index.write_text(json.dumps(searchable(json.loads(index.read_text(encoding="utf-8")))), encoding="utf-8")


def searchable(index: dict[str, Any]) -> dict[str, Any]:
    """Adapt the search's index to what people type.

    Entries of the API have their full name: who looks for "timeout" finds a page before fields. "Wi-Fi" and "ROS 2" in
    a title are found as one word, too.
    """
    for item in index["items"]:
        if item["location"].startswith("api/") and "#" in item["location"]:
            item["title"] = item["location"].partition("#")[2]
        item["title"] = item["title"].replace("Wi-Fi", "Wi-Fi (WiFi)").replace("ROS 2", "ROS 2 (ros2)")
    return index


def collect(pages: Path) -> None:
    """Fills `pages` anew: each page, and each file that one links to."""
    shutil.rmtree(pages, ignore_errors=True)
    shutil.copytree(ROOT / "docs", pages)
    linked: set[str] = set()
    for origin, place in _all_pages().items():
        text, targets = relinked((ROOT / origin).read_text(encoding="utf-8"), origin, place)
        linked |= targets
        _write(pages / place, text)
    for target in linked:
        (pages / _place(target)).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(ROOT / target, pages / _place(target))


def relinked(text: str, origin: str, place: str) -> tuple[str, set[str]]:
    """A page with its links as they are in the site, and the files outside docs/ that they lead to."""
    files: set[str] = set()

    def relink(found: re.Match[str]) -> str:
        before, link, anchor, after = found.groups()
        if "://" in link:
            return found.group()
        target = os.path.normpath(PurePosixPath(origin).parent / link)
        if (ROOT / target).is_file() and target not in OUTSIDE and not target.startswith("docs/"):
            files.add(target)
        return f"{before}{os.path.relpath(_place(target), PurePosixPath(place).parent)}{anchor or ''}{after}"

    return LINK.sub(relink, text), files


def _all_pages() -> dict[str, str]:
    docs = sorted(path.relative_to(ROOT).as_posix() for path in (ROOT / "docs").rglob("*.md"))
    return {**{path: _place(path) for path in docs}, **OUTSIDE}


def _place(target: str) -> str:
    """Where the site has what stands at this path of the repository."""
    if target in OUTSIDE or target in FOLDERS:
        return OUTSIDE.get(target) or FOLDERS[target]
    if target.startswith("docs/"):
        return target.removeprefix("docs/")
    return target if PurePosixPath(target).suffix in SHOWN else f"{target}.txt"


def _write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")


def broken_links(site: Path) -> list[str]:
    """`page: link` for each link, picture and script that does not exist, or that another host would serve."""
    pages = {path: _Page(path) for path in site.rglob("*.html") if path.name != "404.html"}
    broken = []
    for path, page in sorted(pages.items()):
        for link in sorted(page.links):
            target, _, anchor = link.partition("#")
            file = (path.parent / unquote(target)).resolve() if target else path
            there = file.is_file() and (not anchor or file not in pages or unquote(anchor) in pages[file].anchors)
            if not there:
                broken.append(f"{path.relative_to(site)}: {link}")
    return broken


class _Page(HTMLParser):
    """The links within the site and the anchors of one page."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.links: set[str] = set()
        self.anchors: set[str] = set()
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        for name, value in attrs:
            if name == "id" and value:
                self.anchors.add(value)
            elif name in {"href", "src"} and value and (tag != "a" or not urlsplit(value).netloc):
                self.links.add(value)


class PublicApi(griffe.Extension):
    """What the API's pages show: methods as they are when a program runs, and none marked `@private`."""

    def on_package(self, *, pkg: griffe.Module, **_: Any) -> None:
        """Called once for each package that was read."""
        for module in pkg.modules["people"].modules["client"].modules.values() if pkg.path == "gateway" else ():
            _complete(pkg, module)
        owners = list(_owners(pkg))
        private = [(owner, name) for owner in owners for name in owner.members if _is_private(owner, name)]
        for owner, name in private:
            owner.del_member(name)
        for owner in owners:
            if owner.docstring:
                owner.docstring.value = DOCTEST.sub(r"```pycon\n\g<0>\n```", owner.docstring.value)


def _owners(owner: griffe.Object) -> Iterator[griffe.Object]:
    """This module or class, and all modules, classes and functions in it."""
    yield owner
    for member in owner.members.values():
        if isinstance(member, griffe.Object):
            yield from _owners(member)


def _complete(package: griffe.Module, module: griffe.Module) -> None:
    """Methods made at import (`go = waits(Walk.go)`) are shown as those that they are made of, some with `async`."""
    made = [
        (owner, name)
        for owner in module.classes.values()
        if not owner.is_alias
        for name, member in owner.members.items()
        if (name == "__init__" or not name.startswith("_"))
        and isinstance(member, griffe.Attribute)
        and isinstance(member.value, griffe.ExprCall)
    ]
    for owner, name in made:
        method = getattr(getattr(import_module(module.path), owner.name), name, None)
        if isfunction(method) and "<locals>" not in method.__qualname__:  # else a lambda, with no text of its own
            function = copy(package[method.__module__.removeprefix(f"{package.path}.")][method.__qualname__])
            function.labels = {*function.labels, *(("async",) if iscoroutinefunction(method) else ())}
            owner.set_member(name, function)


def _is_private(owner: griffe.Object, name: str) -> bool:
    """Marked by itself or, if it has no docstring, by what it overrides."""
    member = owner.members.get(name)
    if isinstance(member, griffe.Object) and member.docstring:
        return "@private" in member.docstring.value
    return isinstance(owner, griffe.Class) and any(_is_private(base, name) for base in owner.resolved_bases)


if __name__ == "__main__":
    main()
