"""The console's page in a real browser, as a person uses it."""

import re
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from re import Pattern
from typing import Any, ClassVar, Final

from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Browser, BrowserContext, CDPSession, ConsoleMessage, Locator, Page, expect

from tests.support.console_process import Console, SignedIn
from tests.support.cut_link import CutLink
from tests.support.gateway_process import Gateway
from tests.support.waiting import Closing

CHROMIUM: Final = Path("/usr/bin/chromium")
ARGUMENTS: Final = ("--no-sandbox", "--disable-gpu")
"""The tests run as root. Without WebGL a page takes half as much of a processor."""
DRAWS: Final = ("--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist")
"""With it: on the processor."""
LATE_MS: Final = 20_000
"""How long is waited for what takes milliseconds: a busy machine must not fail a test."""

WITHOUT_WEBGL: Final = """
const getContext = HTMLCanvasElement.prototype.getContext;
HTMLCanvasElement.prototype.getContext = function (kind, ...more) {
  return kind.startsWith("webgl") ? null : getContext.call(this, kind, ...more);
};
"""
KEEP_KEY: Final = """
if (location.origin === "%s") localStorage.setItem("hexapod-console-key", "%s");
"""
"""What `enter.js` does in a browser that opens a link."""
VISIBILITY: Final = """
Object.defineProperty(document, "visibilityState", { value: "%s", configurable: true });
document.dispatchEvent(new Event("visibilitychange"));
"""

COUNTS: Final = """
window.wakes = 0;
window.shakes = [];
WakeLock.prototype.request = ((request) => function (kind) {
  window.wakes += 1;
  return request.call(this, kind);
})(WakeLock.prototype.request);
Navigator.prototype.vibrate = (pattern) => window.shakes.push(pattern);
"""
"""Counts how often the screen was to stay on, and what the phone was to do."""

GAMEPAD: Final = """
const made = (index, mapping, id) => ({ connected: true, index, mapping, id, timestamp: 1, axes: [0, 0, 0, 0],
               buttons: Array.from({ length: 17 }, () => ({ pressed: false, value: 0 })) });
window.pad = made(0, "standard", "Pad");
window.pads = [window.pad, made(1, "standard", "Second"), made(2, "", "Unknown stick")];
window.looks = 0;
navigator.getGamepads = () => {
  window.looks += 1;
  if (!window.frozen) window.pad.timestamp += 1;
  return window.pads;
};
"""
"""Three gamepads, of which the first drives; counts how often they were looked at. `frozen`: it is out of reach."""

WISHES: Final = """
window.wishes = [];
const send = WebSocket.prototype.send;
WebSocket.prototype.send = function (text) {
  const message = JSON.parse(text);
  if (message.type === "walk" && window.muted) return;
  if (message.type === "walk") window.wishes.push(message);
  send.call(this, text);
};
"""
"""Keeps the page's wishes for the walk, or keeps them back."""
MOVES: Final = "(each) => each.forward_m_s || each.left_m_s || each.turn_rad_s"
PUSHES: Final = 100
"""In so many it is seconds that pass, where each is rejected at once: until the newest state is fresh again."""
LET_GO: Final = """!document.querySelector('.stick[data-held="yes"]')"""
WALKS: Final = 'document.getElementById("walk-known").textContent.includes("It walks")'

CHANGES: Final = """
const listen = WebSocket.prototype.addEventListener;
WebSocket.prototype.addEventListener = function (name, heard, ...more) {
  listen.call(this, name, name !== "message" ? heard : (event) => {
    const message = JSON.parse(event.data);
    window.change(message);
    heard({ data: JSON.stringify(message) });
  }, ...more);
};
"""
"""Passes each message of the console through `window.change`, which a test has to give."""

LINES: Final = """
addEventListener("DOMContentLoaded", () => {
  let began = false;
  const { dataset } = document.body;
  for (const place of document.querySelectorAll("#said, #stop-line, #word")) {
    new MutationObserver(() => {
      began ||= dataset.live === "yes" || dataset.tone === "watches";
      if (began) console.debug(place.textContent);
    }).observe(place, { childList: true, characterData: true, subtree: true });
  }
});
"""
"""Notes each line that a page says once it has begun, also one that another replaces before anybody reads it."""
HELD_UP: Final = re.compile(
    "was frozen|the newest state is|too late|received nothing|accepts nothing|watchdog|use the switch|NO SIGNAL|is lost"
)
"""What a page says where it, the console or the gateway stood still."""

PHONE: Final[dict[str, Any]] = {"viewport": {"width": 360, "height": 640}, "has_touch": True, "is_mobile": True}

expect.set_options(timeout=LATE_MS)


def lacks() -> str:
    """Return what this machine lacks for a page, in one line; empty when nothing."""
    return "" if CHROMIUM.exists() else "Debian package missing: chromium"


def put_to_rest(gateway: Gateway) -> None:
    """Undo what a test left: take the lease, which stops all legs, and leave STOP ALL."""
    with gateway.client() as robot, robot.lease(take=True):
        if robot.state().mode == "estopped":
            assert robot.reset().accepted


class Visitor(Closing):
    """Opens pages of one console, each in a profile of its own; at the end all are closed, and the robot rests."""

    lines: ClassVar[list[str]] = []
    """What all pages of this test have said."""
    faults: ClassVar[list[str]] = []
    """What they complained of; a connection that ends is no complaint."""

    def __init__(self, browser: Browser, url: str, session: SignedIn, gateway: Gateway | None = None) -> None:
        self._browser = browser
        self._gateway = gateway
        self._url = url
        self._name, _, self._value = session.cookie.partition("=")
        self._keep_key = KEEP_KEY % (url, session.key)
        self._stack = ExitStack()

    def open(self, *, webgl: bool = False, script: str = "", **options: Any) -> "Opened":
        """Open a page that shows the robot. `webgl`: in a browser that draws, for this page alone."""
        browser = self._browser
        if webgl:
            browser = browser.browser_type.launch(executable_path=CHROMIUM, args=DRAWS)
            self._stack.callback(browser.close)
        context = browser.new_context(**options)
        self._stack.callback(context.close)
        context.set_default_timeout(LATE_MS)
        context.add_cookies([{"name": self._name, "value": self._value, "url": self._url}])
        for each in (self._keep_key, LINES, "" if webgl else WITHOUT_WEBGL, script):
            context.add_init_script(each)
        opened = Opened(context, context.new_page())
        opened.page.on("pageerror", lambda error: self.faults.append(str(error)))
        opened.page.on("console", self._heard)
        opened.page.goto(self._url)
        opened.expect_live()
        return opened

    def renderers(self) -> set[int]:
        """Return the process ids of those that run pages."""
        processes = self._browser.new_browser_cdp_session().send("SystemInfo.getProcessInfo")["processInfo"]
        return {each["id"] for each in processes if each["type"] == "renderer"}

    def close(self) -> None:
        """Close all pages; of a `gateway`, whatever they left behind is ended."""
        self._stack.close()
        if self._gateway is not None:
            put_to_rest(self._gateway)

    def _heard(self, message: ConsoleMessage) -> None:
        if message.type == "debug":
            self.lines.append(message.text)
        elif message.type == "error" and not re.search("ERR_CONNECTION|WebSocket|403", message.text):
            self.faults.append(message.text)

    def __exit__(self, *error: object) -> None:
        self.close()
        if error[0] is None:
            assert not self.faults, self.faults


def behind(link: CutLink, browser: Browser, console: Console, gateway: Gateway | None = None) -> Visitor:
    """Return a visitor whose pages reach the console through this link."""
    url = link.endpoint.replace("tcp/", "http://")
    return Visitor(browser, url, console.sign_in(console.new_link().replace(console.url, url)), gateway)


class Opened:
    """One open page."""

    def __init__(self, context: BrowserContext, page: Page) -> None:
        self.context = context
        self.page = page

    def close(self) -> None:
        self.page.close()

    def __getitem__(self, name: str) -> Locator:
        """Return the element with this id."""
        return self.page.locator(f"#{name}")

    @property
    def said(self) -> Locator:
        """Return the line that says what happened."""
        return self["said"]

    def expect_live(self) -> None:
        """Wait until it shows the robot as it is now."""
        expect(self.page.locator("body")).to_have_attribute("data-live", "yes")

    def go_to_button(self) -> None:
        self.page.goto(f"{self.page.url.rstrip('/')}/button")

    def get_lease(self) -> None:
        self["lease-acquire"].click()
        expect(self["driver"]).to_have_text("you")

    def drive(self, *legs: int) -> None:
        """Get the lease and choose these legs."""
        self.get_lease()
        self.show_joints()
        self["run-none"].click()
        for leg in legs:
            self.page.locator("#run-chooser label").nth(leg - 1).click()

    def show_rest(self) -> None:
        """Show what a phone has in the pads' place."""
        if self["more"].is_visible() and self["more"].get_attribute("aria-expanded") == "false":
            self["more"].click()

    def show_joints(self) -> None:
        """Expand the *Advanced* section."""
        self.show_rest()
        if self["advanced"].get_attribute("open") is None:
            self["drive-title"].click()

    def select(self, leg: int) -> None:
        self.show_joints()
        self.page.locator("#leg-chooser label").nth(leg - 1).click()

    def expect_status(self, leg: int, word: str | Pattern[str]) -> None:
        """Wait until the leg's row says so."""
        expect(self[f"leg-row-{leg}"]).to_contain_text(word)

    def module(self, name: str, expression: str, argument: Any = None) -> Any:
        """Return what an expression over a module of the page's says: `module("kinematics", "(m, a) => m.LEGS")`."""
        return self.page.evaluate(f"async (a) => ({expression})(await import('/{name}.js'), a)", argument)

    def violations(self) -> dict[tuple[str, str], str]:
        """Return axe's violations: by color scheme and rule, the first element."""
        found = {}
        for scheme in ("dark", "light"):  # as it was
            self.page.emulate_media(color_scheme=scheme)
            for each in Axe().run(self.page).response["violations"]:
                found[scheme, each["id"]] = each["nodes"][0]["html"]
        return found

    def devtools(self) -> CDPSession:
        return self.context.new_cdp_session(self.page)

    def hide(self) -> None:
        """Hide the page, as if another tab were in front, or the phone locked."""
        self.page.evaluate(VISIBILITY % "hidden")

    def show(self) -> None:
        self.page.evaluate(VISIBILITY % "visible")

    def lose_focus(self) -> None:
        """Bring another window to the front."""
        self.devtools().send("Emulation.setFocusEmulationEnabled", {"enabled": False})
        other = self.context.new_page()
        self.context.new_cdp_session(other).send("Emulation.setFocusEmulationEnabled", {"enabled": False})
        other.bring_to_front()


def push(page: Opened) -> None:
    """Push the pad ahead, and a little to the right."""
    page.page.mouse.up()
    box = page["pad"].bounding_box()
    assert box is not None
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.page.mouse.move(x, y)
    page.page.mouse.down()
    page.page.mouse.move(x + 0.05 * box["width"], y - 0.4 * box["height"])


def expect_still(page: Opened) -> None:
    """Check that no wish of a second moves."""
    page.page.evaluate("window.wishes = []")
    page.page.wait_for_function("() => window.wishes.length > 20")
    assert not page.page.evaluate(f"window.wishes.some({MOVES})")


def again(page: Opened, act: Callable[[], None], came: str, ended: str) -> None:
    """Act until `came` holds in the page. Act again if `ended` holds first, since the machine stood still."""
    for _ in range(PUSHES):
        act()
        page.page.wait_for_function(f"() => ({came}) || ({ended})")
        if page.page.evaluate(came):
            return
    raise AssertionError(page.said.text_content())


def walks(page: Opened, push: Callable[[Opened], None]) -> None:
    """Push until the robot walks."""
    again(page, lambda: push(page), WALKS, LET_GO)
