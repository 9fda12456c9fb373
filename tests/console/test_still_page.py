"""The driving page stands still: whatever appears or is said, nothing moves under a thumb, and no line is cut off."""

import datetime as dt
import itertools
from collections.abc import Sequence
from typing import Any, Final

import pytest
from playwright.sync_api import expect

from tests.console.browser import Opened, Visitor

pytestmark = [pytest.mark.browser, pytest.mark.nightly]

HELD: Final = ((320, 568), (568, 320), (360, 640), (640, 360), (390, 844), (844, 390), (768, 1024), (1024, 768))
DESKS: Final = ((1280, 800), (1440, 900))
SMALL: Final = ((390, 400), (360, 320), (320, 200), (500, 270))
"""Half of a split screen, and phones with a keyboard open."""
FLAT: Final = ((1000, 450), (1024, 456), (1200, 460), (1400, 320))
"""Windows of a desk above another one."""
HEAR: Final = """
const listen = WebSocket.prototype.addEventListener;
WebSocket.prototype.addEventListener = function (name, heard, ...more) {
  if (name !== "message") return listen.call(this, name, heard, ...more);
  window.hear = (message) => heard({ data: JSON.stringify(message) });
  listen.call(this, name, (event) => {
    if (window.situation) return;
    const message = JSON.parse(event.data);
    if (message.type === "state") [window.newest, window.newestMs] = [message, performance.now()];
    heard(event);
  }, ...more);
};
const every = window.setInterval;
window.setInterval = (run, ms) => {
  if (ms === 100) window.refresh = run;
  return every(run, ms);
};
"""
"""Lets a test say what the console says, and look at the page at once."""
SHOW: Final = """([messages, state]) => {
  window.situation = true;
  // as long as what they say; nothing stands behind them
  const LINES = ".facts div, dt, dd, #robot, #said, #stop-known, #stop-known *, #walk-known, #quality, #quality *";
  const { newest } = window;
  for (const message of messages) hear(message);
  const uptime_s = newest.state.uptime_s + (performance.now() - newestMs) / 1000; // it is fresh
  hear({ ...newest, now: state.now ?? newest.now, state: { ...newest.state, uptime_s, ...state } });
  refresh();
  const boxes = {};
  for (const each of document.querySelectorAll("header *, #stop, #stop *, #said, .see, #picture, .walk, .walk *")) {
    const shown = each.checkVisibility({ visibilityProperty: true });
    if (!shown || each.closest(".aloud, .knob, svg, #labels") || each.matches(LINES)) continue;
    const { left, top, width, height } = each.getBoundingClientRect();
    const name = each.id || `${each.closest("[id]")?.id} ${each.tagName} ${each.textContent.slice(0, 12)}`;
    boxes[name] = [left, top, width, height].map(Math.round).join(" ");
  }
  const cut = ["said", "stop-known", "walk-known", "mode", "age", "lease-hand-over", "measured"].filter((id) => {
    const each = document.getElementById(id);
    const { left, top, right, bottom } = each.getBoundingClientRect();
    const inside = left >= 0 && top >= 0 && right <= innerWidth && bottom <= innerHeight;
    const fits = each.scrollWidth <= each.clientWidth && each.scrollHeight <= each.clientHeight;
    return each.checkVisibility() && !(inside && fits);
  });
  const covered = [];
  const over = (each, x, y) => {
    const found = document.elementFromPoint(x, y);
    return !each.contains(found) && !(found?.closest("#said") && each.closest(".see")) && (found ?? document.body);
  };
  const texts = "#stop-known *, #measured > *, #walk-known, .facts div, #quality";
  for (const each of document.querySelectorAll(`button:not(.label), label, .stick, #picture, ${texts}`)) {
    const { left, top, right, bottom, width, height } = each.getBoundingClientRect();
    if (!width || !height || !each.checkVisibility() || each.closest(".rest, dialog, .aloud")) continue;
    const corners = each.matches(".stick") ? [] : [[1, 1], [1, -1], [-1, 1], [-1, -1]];
    for (const [x, y] of [[0, 0], ...corners.map(([x, y]) => [x * (width / 2 - 6), y * (height / 2 - 6)])]) {
      const by = over(each, (left + right) / 2 + x, (top + bottom) / 2 + y);
      if (by) covered.push(`${each.id || each.textContent} is covered by ${by.id || by.outerHTML.slice(0, 60)}`);
    }
  }
  const picture = document.getElementById("picture").getBoundingClientRect();
  for (const each of document.querySelectorAll(".label")) {
    const { left, top, right, bottom } = each.getBoundingClientRect();
    if (left < picture.left - 1 || right > picture.right + 1 || top < picture.top - 1 || bottom > picture.bottom + 1) {
      if (each.checkVisibility()) covered.push(`label ${each.textContent} is not on the picture`);
    }
  }
  const { scrollWidth, scrollHeight } = document.documentElement;
  return { boxes, cut, covered, scrolls: scrollWidth > innerWidth || scrollHeight > innerHeight };
}"""
HANDS: Final = """() => {
  const box = (id) => document.getElementById(id).getBoundingClientRect();
  const faults = [];
  const small = (where) => {
    for (const each of document.querySelectorAll("button, select, summary, input, a, [role=application]")) {
      const target = each.matches(".segments input") ? each.closest("label") : each;
      if (!target.checkVisibility() || target.matches(".label")) continue;
      const { width, height } = target.getBoundingClientRect();
      if (width < 44 || height < 44) faults.push(`${where}: ${each.id || each.textContent} is ${width} by ${height}`);
    }
  };
  small("driving");
  const [pad, turn, stop, picture] = ["pad", "turn", "stop-all", "picture"].map(box);
  for (const thumb of [pad, turn]) {
    const across = Math.max(thumb.left - stop.right, stop.left - thumb.right);
    const down = Math.max(thumb.top - stop.bottom, stop.top - thumb.bottom);
    if (Math.max(across, down) < 16) faults.push("STOP ALL is under a thumb");
  }
  const [x, y] = [turn.left + turn.width / 2, turn.top + turn.height / 2];
  const nearest = [Math.min(stop.right, Math.max(stop.left, x)), Math.min(stop.bottom, Math.max(stop.top, y))];
  const reach = Math.hypot(x - nearest[0], y - nearest[1]);
  if (reach > 320) faults.push(`STOP ALL is ${reach} pixels from the thumb that turns`);
  if (pad.left > 24 || turn.right < innerWidth - 24) faults.push("the pads are not at the edges");
  const wide = innerWidth > innerHeight;
  if (wide && (pad.right > picture.left || picture.right > turn.left)) faults.push("the picture is not between");
  if (picture.height < 64) faults.push(`the picture is ${picture.height} pixels high`);
  if (pad.width < Math.min(0.28 * innerHeight, 0.45 * innerWidth) && !wide) faults.push("the pads are small");
  document.getElementById("more").click();
  for (const each of document.querySelectorAll("details")) each.open = true;
  small("the rest");
  if (document.getElementById("pad").checkVisibility()) faults.push("the rest is not in the pads' place");
  const rest = box("rest");
  const covers = rest.right > stop.left && rest.left < stop.right && rest.bottom > stop.top && rest.top < stop.bottom;
  if (covers || document.documentElement.scrollWidth > innerWidth) faults.push("the rest is not beside STOP ALL");
  document.getElementById("more").click();
  return faults;
}"""
"""What is too small for a finger, or not where the thumbs are; 320 pixels of a phone are some 5 cm."""
ASKS: Final = """() => {
  const box = (id) => document.getElementById(id).getBoundingClientRect();
  const dialog = document.getElementById("question");
  const [title, words, yes] = ["title", "text", "yes"].map((part) => document.getElementById(`question-${part}`));
  title.textContent = "Take the lease from anna-katharina.oberhuber@robots.example (page 12)?";
  words.textContent = "All six legs stop first, and servos that stop hold no weight.";
  yes.textContent = "Stop all legs and take it";
  dialog.show();
  const [asks, answer] = [box("question"), box("question-yes")];
  const across = (other) => other.left < asks.right && other.right > asks.left;
  const hit = (other) => across(other) && other.top < asks.bottom && other.bottom > asks.top;
  const under = ["pad", "turn", "stop-all", "stop-known"].filter((id) => hit(box(id)));
  const faults = under.map((id) => `the question is over ${id}`);
  if (asks.left < 0 || asks.right > innerWidth || answer.bottom > asks.bottom) faults.push("the question is cut off");
  dialog.close("no");
  return faults;
}"""
"""What the longest question covers."""
ENDLESS: Final = """() => {
  const said = document.getElementById("said");
  said.textContent = "Nothing moves: this is a long story. ".repeat(300);
  const [{ bottom }, { top }] = [said, document.getElementById("lease")].map((each) => each.getBoundingClientRect());
  return bottom <= top && said.scrollHeight > said.clientHeight;
}"""
LONG: Final = "anna-katharina.oberhuber@robots.example (page 12)"


def lease(holder: str | None, *, held_s: float | None = 1.0, asked_by: str | None = None) -> dict[str, Any]:
    return {"lease": {"holder": holder, "held_s": held_s, "asked_by": asked_by, "verified": False}}


def mine(yes: bool) -> dict[str, Any]:
    return {"type": "lease", "mine": yes, "ttl_ms": 1_000_000}


NOW: Final = {
    "moving": "It moves to another posture",
    "halted": "Legs 1, 2, 3, 4 and 5 are stopped, and the others stand still",
    "sitting": "What it does is not known: the newest state is 12 s old",
}
"""The longest sentences of gateway/people/walking/words.py."""

MEASURED: Final = {
    "type": "telemetry",
    "telemetry": {
        "age_ms": 0, "temperature_c": -40, "battery": {"voltage_v": 11.1, "percent": 10}, "tilt_deg": 179.9,
        "imu": {"orientation_wxyz": [1, 0, 0, 0]}, "feet": [1, 1, 1, 0, 0, 0],
    },
}  # fmt: skip
"""In as many letters as it may take."""

FELT: Final = "Leans by 14.9°, 15.0° corrected; legs 1, 2, 3, 4 and 5 carry; leg 6 hangs over an edge"
"""The longest usual sentence of what a walk by sensors feels."""


def walk(posture: str | None, detail: str = "", limit: str = "", ground: str = "") -> dict[str, Any]:
    """Return what the console reports of a walk."""
    return {
        "type": "walk", "press": 10**6, "id": None, "posture": posture, "gait": "ripple", "height_m": 0.15,
        "now": NOW.get(posture or "", "It walks"),
        "commanded": [0.1, -0.1, 0.4], "scaled": [0.1, -0.1, 0.4], "limit": limit, "lost": [], "waits": False,
        "ground": ground, "detail": detail,
    }  # fmt: skip


def situations(source: str) -> dict[str, tuple[list[dict[str, Any]], dict[str, Any]]]:
    """Return by name what the console reports, and how the newest state differs. `source`: this page's name."""
    now = dt.datetime.now(dt.UTC)
    why = "the servo 12 would stand at 190.5 degrees, and may go from 0 to 180"
    gone = "the console has lost the gateway: no answer at tls/hexapod.local:7447 for 12 s, and the name is known"
    return {
        "free": ([], lease(None)),
        "another's": ([mine(False)], lease("bert (page 2)")),
        "another's with a long name": ([], lease(LONG)),
        "handed over to this page": ([], lease(source, held_s=None)),
        "mine": ([mine(True)], lease(source)),
        "asked for": ([], lease(source, asked_by="bert (page 2)")),
        "asked for by a long name": ([], lease(source, asked_by=LONG)),
        **{
            posture: ([walk(posture)], lease(source))
            for posture in ("moving", "standing", "walking", "halted", "sitting")
        },
        "limited": ([walk("walking", limit=why)], lease(source)),
        "asked for while it walks": ([walk("walking")], lease(source, asked_by="bert (page 2)")),
        "ended": ([walk(None, detail=f"leg 1 was stopped by somebody: {why}; {why}")], lease(source)),
        "stop buttons": ([], {**lease(source), "buttons": {"required": 2, "alive": 1, "names": [LONG]}}),
        **{
            f"stopped by somebody{since}": (
                [],
                {**lease(source), "mode": "estopped", "estop_source": LONG, "estop_since": at.isoformat()},
            )
            for since, at in (("", now), (" long ago", now - dt.timedelta(days=40)))
        },
        "a bus fault": ([], {**lease(LONG, asked_by=LONG), "mode": "bus_fault"}),
        "measured": ([MEASURED], lease(source)),
        "by sensors": ([MEASURED, walk("walking", ground=FELT)], lease(source)),
        "controller silent": ([MEASURED, walk("walking")], {**lease(source), "controller": {"alive": False}}),
        "no gateway": ([{"type": "link", "status": "gone", "detail": gone}, mine(False)], lease(LONG)),
        "a gateway again": ([{"type": "link", "status": "connected", "detail": ""}], lease(None)),
    }


@pytest.mark.parametrize("size", [*HELD, *DESKS], ids=lambda size: f"{size[0]}x{size[1]}")
def test_nothing_on_the_driving_page_shifts_is_covered_cut_off_or_out_of_a_thumbs_reach(
    size: tuple[int, int], visitor: Visitor
) -> None:
    width, height = size
    held = size in HELD
    page = visitor.open(script=HEAR, viewport={"width": width, "height": height}, has_touch=held, is_mobile=held)
    found = faults(page)
    found += page.page.evaluate(ASKS)
    if held:
        found += page.page.evaluate(HANDS)
        found += [] if page.page.evaluate(ENDLESS) else ["what was said covers more than the picture"]
    assert not found, "\n".join(found)


OVERLAPS: Final = """() => {
  const faults = [];
  const box = (each) => each.getBoundingClientRect();
  const named = (each) => each.id || each.textContent.trim();
  const controls = [...document.querySelectorAll("button, .segments label, .stick")].filter(
    (each) => each.checkVisibility({ visibilityProperty: true }) && !each.closest(".rest, dialog"));
  controls.forEach((one, index) => {
    const a = box(one);
    if (a.left < 0 || a.top < 0 || a.right > innerWidth || a.bottom > innerHeight) faults.push(`${named(one)} is cut`);
    for (const other of controls.slice(index + 1)) {
      const b = box(other);
      const across = Math.min(a.right, b.right) - Math.max(a.left, b.left);
      const down = Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top);
      if (across > 1 && down > 1) faults.push(`${named(one)} and ${named(other)} overlap`);
    }
  });
  const badges = controls.filter((each) => each.matches(".label"));
  if (badges.length !== 6) faults.push(`${badges.length} badges of legs`);
  for (const each of badges) {
    const small = parseFloat(getComputedStyle(each).fontSize) < 10 || box(each).width < 24;
    if (small) faults.push(`badge ${named(each)} is small`);
  }
  const stopped = document.body.querySelector("#reset").checkVisibility();
  for (const id of stopped ? ["stop-all", "reset"] : ["stop-all"]) {
    const { left, top, width, height } = box(document.getElementById(id));
    const hit = document.elementFromPoint(left + width / 2, top + height / 2);
    if (width < 44 || height < 43.5 || !hit?.closest(`#${id}`)) faults.push(`${id} cannot be tapped`);
  }
  return faults;
}"""
"""Controls that are over another or cut, badges that nobody can read, and whether STOP ALL and Reset can be tapped."""


SIZES: Final = pytest.mark.parametrize("size", [*SMALL, *HELD, *FLAT, *DESKS], ids=lambda size: f"{size[0]}x{size[1]}")


@SIZES
def test_no_control_is_over_another_or_cut_and_stop_all_can_be_tapped(size: tuple[int, int], visitor: Visitor) -> None:
    overlap_nowhere(size, visitor)


def overlap_nowhere(size: tuple[int, int], visitor: Visitor, views: Sequence[str] = ("no",)) -> None:
    """Look at each situation, and at what *More* shows. `views`: whether the camera's picture is alone."""
    width, height = size
    held = size not in (*FLAT, *DESKS)
    page = visitor.open(script=HEAR, viewport={"width": width, "height": height}, has_touch=held, is_mobile=held)
    found = list[str]()
    for name, shown in situations("root").items():
        page.page.evaluate(SHOW, shown)
        mores = ("no", "yes") if page["more"].is_visible() else ("no",)
        for more, alone in itertools.product(mores, views):
            page.page.evaluate("(more) => { document.body.dataset.more = more; }", more)
            page["picture"].evaluate("(each, alone) => { each.dataset.alone = alone; }", alone)
            found += [f"{name}, more {more}, alone {alone}: {fault}" for fault in page.page.evaluate(OVERLAPS)]
        page.page.evaluate("document.body.dataset.more = 'no'")
    assert not found, "\n".join(found[:20])


def faults(page: Opened) -> list[str]:
    """Return the page's faults as sentences."""
    found, places = [], dict[str, tuple[str, str]]()
    for name, told in situations("root").items():
        seen = page.page.evaluate(SHOW, told)
        for element, box in seen["boxes"].items():
            since, before = places.setdefault(element, (name, box))
            if box != before:
                found.append(f"{name}: {element} is at {box}, and {since}: at {before}")
        found += [f"{name}: {element} is cut" for element in seen["cut"]]
        found += [f"{name}: {element}" for element in dict.fromkeys(seen["covered"])]
        found += [f"{name}: the page scrolls"] if seen["scrolls"] else []
    return found


def test_what_a_walk_by_sensors_feels_is_on_the_picture_and_why_it_stands_still_is_said(visitor: Visitor) -> None:
    page = visitor.open(script=HEAR)
    shown = situations("root")
    page.page.evaluate(SHOW, shown["by sensors"])
    expect(page["ground"]).to_have_text(FELT)
    over = walk("standing", limit="no ground under leg 6: it hangs over an edge")
    page.page.evaluate(SHOW, ([{**over, "scaled": [0, 0, 0]}], shown["mine"][1]))
    expect(page.said).to_have_text("It stands still: no ground under leg 6: it hangs over an edge.")
    page.page.evaluate(SHOW, shown["limited"])
    expect(page.said).to_contain_text("Slower than that: ")
    expect(page["ground"]).to_be_hidden()


def test_without_the_gateway_nobody_knows_what_a_walk_does(visitor: Visitor) -> None:
    page = visitor.open(script=HEAR)
    [gone, _], state = situations("root")["no gateway"]
    page.page.evaluate(SHOW, ([walk("walking"), gone], state))
    expect(page["walk-known"]).to_have_text("What it does is not known.")
