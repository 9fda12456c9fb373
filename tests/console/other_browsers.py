"""WebKit and Firefox, driven as a person drives them. Both speak WebDriver: over HTTP, or over a socket of its own.

Playwright's own builds of them are others than Debian's; Debian's Firefox has no geckodriver, whose language this is.
"""

import itertools
import json
import os
import shutil
import socket
from abc import abstractmethod
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Final, cast

import httpx

from tests.support.child import Child
from tests.support.gateway_process import free_port
from tests.support.waiting import Closing

NEEDS: Final = {
    "webkit2gtk-driver": "WebKitWebDriver",
    "xvfb": "Xvfb",
    "matchbox-window-manager": "matchbox-window-manager",
    "firefox-esr": "firefox-esr",
}
"""Debian package: a program of it."""
LATE_S: Final = 60.0
"""For what takes two seconds on a machine that is not busy: to start a browser."""
PAGES: Final = 3
"""A link leads to two more."""
WINDOW: Final = "1000x900x24"
FIREFOX: Final = """
user_pref("marionette.port", 0);
user_pref("remote.log.level", "Info");
"""
SHOWN: Final = """
const shown = (element) => element.checkVisibility() && !element.disabled;
const named = (words) => [...document.querySelectorAll("button, [role=button]")].find(
  (each) => shown(each) && each.textContent.trim().startsWith(words));
const labelled = (words) => [...document.querySelectorAll("[aria-label]")].find(
  (each) => shown(each) && each.getAttribute("aria-label").startsWith(words));
"""
"""Elements as a person finds them, however the page is laid out."""


def lacks() -> str:
    """Return what this machine lacks for these browsers, in one line; empty when nothing."""
    missing = [package for package, program in NEEDS.items() if shutil.which(program) is None]
    return f"Debian packages missing: {' '.join(missing)}" if missing else ""


class OtherBrowser(Closing):
    """A browser with one window; its constructor returns when it has one.

    It is driven by a thumb. WebKit without a touch screen makes a mouse's events of that.
    """

    def __init__(self, home: Path, *, accepts_any_certificate: bool = False) -> None:
        self._accepts = accepts_any_certificate
        self.env = {**os.environ, "HOME": str(home), "XDG_RUNTIME_DIR": str(home)}
        self._stack = ExitStack()
        try:
            self._begin()
        except BaseException:
            self._stack.close()
            raise

    @abstractmethod
    def _begin(self) -> None:
        """Start it."""

    @abstractmethod
    def ask(self, command: str, **parameters: Any) -> Any:
        """Send one of WebDriver's commands. Return its value."""

    def close(self) -> None:
        self._stack.close()

    def go_to(self, url: str) -> None:
        self.ask("Navigate", url=url)

    def find(self, expression: str) -> Any:
        """Return the value of an expression in the page."""
        return self.ask("ExecuteScript", script=f"{SHOWN} return {expression};", args=[])

    def wait(self, condition: str) -> None:
        """Wait until it holds in the page; 30 s at most, as WebDriver has it."""
        look = f"const look = () => ({condition}) ? done(true) : setTimeout(look, 20);"
        for left in reversed(range(PAGES)):
            try:
                self.ask("ExecuteAsyncScript", script=f"{SHOWN} const done = arguments[0]; {look} look();", args=[])
                return
            except AssertionError as error:  # the page that was asked has gone on to the next
                if "unload" not in str(error) or not left:
                    raise

    def wait_for_words(self, words: str) -> None:
        """Wait until they stand on the page."""
        self.wait(f"document.body.innerText.includes({json.dumps(words)})")

    def click(self, words: str) -> None:
        """Press the button whose name begins so, once it is there."""
        element = f"named({json.dumps(words)})"
        self.wait(element)
        self._point(self._middle(element), [{"type": "pointerDown", "button": 0}, {"type": "pointerUp", "button": 0}])

    def push_ahead(self, label: str) -> None:
        """Hold what has this label, and push it ahead, until `let_go`."""
        x, y, height = self._middle(f"labelled({json.dumps(label)})")
        ahead = {"type": "pointerMove", "duration": 50, "x": x, "y": round(y - 0.4 * height)}
        self._point((x, y, height), [{"type": "pointerDown", "button": 0}, ahead])

    def let_go(self) -> None:
        """Let go of what is held."""
        self.ask("PerformActions", actions=[_thumb([{"type": "pointerUp", "button": 0}])])

    def _middle(self, element: str) -> tuple[int, int, float]:
        """Return the middle of an element, and its height."""
        self.find(f'{element}.scrollIntoView({{ block: "nearest" }})')
        box = cast(Mapping[str, float], self.find(f"{element}.getBoundingClientRect().toJSON()"))
        return round(box["x"] + box["width"] / 2), round(box["y"] + box["height"] / 2), box["height"]

    def _point(self, at: tuple[int, int, float], then: list[dict[str, Any]]) -> None:
        self.ask("PerformActions", actions=[_thumb([{"type": "pointerMove", "x": at[0], "y": at[1]}, *then])])


def _thumb(actions: list[dict[str, Any]]) -> dict[str, Any]:
    return {"type": "pointer", "id": "thumb", "parameters": {"pointerType": "touch"}, "actions": actions}


class WebKit(OtherBrowser):
    """Debian's WebKitGTK. It needs a display, and a window manager that gives its window the focus."""

    PATHS: Final = {
        "Navigate": "url",
        "ExecuteScript": "execute/sync",
        "ExecuteAsyncScript": "execute/async",
        "PerformActions": "actions",
    }

    def _begin(self) -> None:
        xvfb = Child(["Xvfb", "-displayfd", "1", "-screen", "0", WINDOW, "-nolisten", "tcp"], self.env)
        self._stack.enter_context(xvfb)
        env = {**self.env, "DISPLAY": f":{xvfb.wait_for_line(0, LATE_S).strip()}"}
        self._stack.enter_context(Child(["matchbox-window-manager", "-use_titlebar", "no"], env))
        port = free_port()
        self._stack.enter_context(Child(["WebKitWebDriver", f"--port={port}"], env))
        (program,) = Path("/usr/lib").glob("*/webkit2gtk-4.1/MiniBrowser")
        options = {"binary": str(program), "args": ["--automation"]}
        matches = {"webkitgtk:browserOptions": options, "acceptInsecureCerts": self._accepts}
        wanted = {"capabilities": {"alwaysMatch": matches}}
        dials = httpx.HTTPTransport(retries=8)  # with pauses that grow: until it listens
        self._http = self._stack.enter_context(
            httpx.Client(base_url=f"http://127.0.0.1:{port}", transport=dials, timeout=LATE_S)
        )
        self._session = f"/session/{self._post('/session', wanted)['sessionId']}"
        self._stack.callback(self._http.delete, self._session)

    def ask(self, command: str, **parameters: Any) -> Any:
        return self._post(f"{self._session}/{self.PATHS[command]}", parameters)

    def _post(self, path: str, payload: Mapping[str, Any]) -> Any:
        answer = self._http.post(path, json=payload)
        assert answer.status_code == 200, answer.text
        return answer.json()["value"]


class Firefox(OtherBrowser):
    """Debian's Firefox ESR, without a display; Marionette is its own form of WebDriver."""

    def _begin(self) -> None:
        home = Path(self.env["HOME"])
        (home / "user.js").write_text(FIREFOX)
        child = Child(["firefox-esr", "--marionette", "--headless", "--no-remote", "--profile", str(home)], self.env)
        self._stack.enter_context(child)
        port = int(child.wait_for_output("Listening on port", LATE_S).rsplit(maxsplit=1)[-1])
        self._socket = self._stack.enter_context(socket.create_connection(("127.0.0.1", port), LATE_S))
        self._read = self._stack.enter_context(self._socket.makefile("rb"))
        self._numbers = itertools.count(1)
        self._receive()  # its greeting
        self.ask("NewSession")

    def ask(self, command: str, **parameters: Any) -> Any:
        text = json.dumps([0, next(self._numbers), f"WebDriver:{command}", parameters]).encode()
        self._socket.sendall(b"%d:%b" % (len(text), text))
        _, _, error, result = self._receive()
        assert error is None, error["message"]
        return result.get("value")

    def _receive(self) -> Any:
        length = b"".join(iter(lambda: self._read.read(1), b":"))
        return json.loads(self._read.read(int(length)))
