// @ts-check
/**
 * Gamepads (standard mapping): a gamepad's sticks walk. While its right trigger is pulled they turn the joints of the
 * selected leg instead, and nothing runs without it. STOP ALL is on every gamepad, whatever its mapping.
 *
 * A wireless gamepad that is out of reach looks like one that is held: browsers show its last values for ever. So one
 * whose clock stands still while something is held counts as let go. Many gamepads report changes only; of one that never
 * repeats a report, a dead-man button that is held is enough for a while.
 */

import { byId, show, text } from "./dom.js";
import { Sticks } from "./stick.js";

const TRIGGER = 7;
const STAND_BUTTON = 0;
const STOP_BUTTON = 1;
const SIT_BUTTON = 2;
const SHOULDERS = [4, 5];
const PRESSED = 0.5;
const DEAD_ZONE = 0.15;
const SPEED_DEG_S = 60;
/** Left stick sideways, left stick up and down, right stick up and down: joints 1, 2 and 3. */
const AXES = [0, 1, 3];
/** A press can be as short as 20 ms. A display's frames are no measure: they take longer while the machine is busy. */
const LOOK_MS = 8;
/** A hand that holds a stick moves it a little all the time, but not at its end. */
const SILENT_MS = 500;
/** So many reports without a change in a row show that a gamepad repeats what it reports. */
const REPEATS = 5;
/** Longer than anybody walks straight on in a room; a shoulder button that is held shows that more is intended. */
const PUSH_MS = 10_000;

/** One gamepad that may drive. */
class Known {
  /** @param {string} id @param {number} nowMs */
  constructor(id, nowMs) {
    this.id = id;
    this.sticks = new Sticks();
    /** What drives the walk, as one (`walk.js`). */
    this.group = [this.sticks];
    /** The trigger was released, so its next pull is intended. */
    this.ready = false;
    this.pressing = true;
    /** The gamepad's clock and values, and when this page last saw the clock go on. */
    this.timestamp = NaN;
    this.values = "";
    this.seenMs = nowMs;
    /** Reports in a row that changed nothing, and whether it repeats its reports. */
    this.same = 0;
    this.repeats = false;
    /** When its sticks were last in the middle. */
    this.centredMs = nowMs;
  }

  /** Why what it holds counts no longer, in words that stay true; "" if it counts. @param {Gamepad} pad @param {number} nowMs */
  whyNot(pad, nowMs) {
    if (pad.timestamp !== this.timestamp) {
      const values = [...pad.axes, ...pad.buttons.map((button) => button.value)].join();
      this.same = values === this.values ? this.same + 1 : 0;
      this.repeats ||= this.same >= REPEATS;
      [this.timestamp, this.values, this.seenMs] = [pad.timestamp, values, nowMs];
    }
    const sticks = pad.axes.some(beyond);
    const pulled = isPulled(pad);
    const shoulder = SHOULDERS.some((button) => pad.buttons[button]?.pressed);
    if (!sticks || shoulder) this.centredMs = nowMs;
    const deadMan = shoulder || pulled;
    const silentMs = nowMs - this.seenMs;
    const longestMs = deadMan && !this.repeats ? PUSH_MS : SILENT_MS;
    if ((sticks || pulled) && silentMs > longestMs) {
      const why = `the gamepad sent nothing for ${longestMs / 1000} s`;
      return this.repeats || deadMan ? why : `${why}; to hold a stick at its end, hold a shoulder button too`;
    }
    if (nowMs - this.centredMs > PUSH_MS) return `a stick was pushed for ${PUSH_MS / 1000} s; to push it longer, hold a shoulder button`;
    return "";
  }
}

export class Pad {
  /**
   * @param {import("./hold.js").Hold} hold @param {import("./targets.js").Targets} targets
   * @param {import("./walk.js").Walk} walk
   * @param {{leg: () => number, stopAll: () => void, say: import("./words.js").Say}} callbacks
   */
  constructor(hold, targets, walk, callbacks) {
    this.hold = hold;
    this.walk = walk;
    this.targets = targets;
    this.callbacks = callbacks;
    /** The gamepads that may drive, by their places. @type {Map<number, Known>} */
    this.known = new Map();
    /** The one whose trigger runs a leg. @type {Known | null} */
    this.holder = null;
    /** The gamepads whose STOP ALL is pressed; null before the first look. @type {Set<number> | null} */
    this.stopping = null;
    this.unusable = "";
    window.addEventListener("gamepaddisconnected", ({ gamepad }) => this.#lost(gamepad.index));
    setInterval(() => this.#look(), LOOK_MS);
  }

  /** Move the selected leg's targets by the sticks. @param {number} elapsedMs */
  steer(elapsedMs) {
    this.#look();
    const pad = connectedPads().find(({ index }) => this.holder !== null && this.known.get(index) === this.holder);
    if (!pad) return;
    AXES.forEach((axis, index) => {
      const value = pad.axes[axis] ?? 0;
      if (Math.abs(value) < DEAD_ZONE) return;
      const servo = this.callbacks.leg() * 10 + index + 1;
      const turn = index === 0 ? value : -value; // up is more
      this.targets.set(servo, this.targets.get(servo) + (turn * SPEED_DEG_S * elapsedMs) / 1000);
    });
  }

  #look() {
    const pads = connectedPads();
    const stops = pads.filter((pad) => pad.buttons[STOP_BUTTON]?.pressed).map((pad) => pad.index);
    if (stops.some((index) => this.stopping?.has(index) === false)) this.callbacks.stopAll();
    this.stopping = new Set(stops);
    const usable = pads.filter((pad) => pad.mapping === "standard");
    this.#name(pads.filter((pad) => !usable.includes(pad)).map((pad) => pad.id));
    show(byId("gamepad"), usable.length > 0);
    text(byId("gamepad-leg"), String(this.callbacks.leg()));
    for (const [index, { id }] of this.known) {
      if (!usable.some((pad) => pad.index === index && pad.id === id)) this.#lost(index);
    }
    const nowMs = performance.now();
    for (const pad of usable) {
      const known = this.known.get(pad.index) ?? new Known(pad.id, nowMs);
      this.known.set(pad.index, known);
      const why = known.whyNot(pad, nowMs);
      if (why) this.#drop(known, why);
      else this.#take(pad, known);
    }
  }

  /** Those of which only STOP ALL works. @param {string[]} ids */
  #name(ids) {
    const unusable = ids.length ? `No gamepad that this browser knows the buttons of: ${ids.join(", ")}. Its second button is STOP ALL.` : "";
    if (unusable === this.unusable) return;
    this.unusable = unusable;
    show(byId("gamepad-unusable"), unusable !== "");
    text(byId("gamepad-unusable"), unusable);
    if (unusable) this.callbacks.say(() => (this.unusable === unusable ? unusable : ""));
  }

  /** The gamepad in this place is gone; another one there needs a press of its own. @param {number} index */
  #lost(index) {
    const known = this.known.get(index);
    this.known.delete(index);
    if (known) this.#drop(known, "the gamepad was disconnected");
  }

  /** What it holds no longer counts. @param {Known} known @param {string} why */
  #drop(known, why) {
    known.ready = false;
    if (this.walk.driving === known.group) this.walk.drop(why);
    known.sticks.release();
    if (this.holder !== known) return;
    this.holder = null;
    this.hold.drop(why);
  }

  /** @param {Gamepad} pad @param {Known} known */
  #take(pad, known) {
    const pulled = isPulled(pad);
    if (pulled) known.sticks.release();
    else this.walk.steer(known.group, beyond(pad.axes[0]), -beyond(pad.axes[1]), beyond(pad.axes[2]));
    const [stand, sit] = [STAND_BUTTON, SIT_BUTTON].map((button) => pad.buttons[button]?.pressed ?? false);
    const free = this.walk.driving === null || this.walk.driving === known.group;
    if ((stand || sit) && !known.pressing && free) this.walk.go(sit);
    known.pressing = stand || sit;
    if (pulled && known.ready && !this.hold.active) {
      this.holder = known;
      this.hold.press("gamepad");
    } else if (!pulled && this.holder === known) {
      this.holder = null;
      this.hold.release("gamepad");
    }
    known.ready = !pulled;
  }
}

/** @param {Gamepad} pad */
function isPulled(pad) {
  return (pad.buttons[TRIGGER]?.value ?? 0) > PRESSED;
}

/** @param {number | undefined} value */
function beyond(value = 0) {
  return Math.abs(value) < DEAD_ZONE ? 0 : value;
}

/** @returns {Gamepad[]} */
function connectedPads() {
  return [...(navigator.getGamepads?.() ?? [])].flatMap((pad) => (pad?.connected ? [pad] : []));
}
