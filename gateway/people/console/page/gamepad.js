// @ts-check
/**
 * A gamepad (standard mapping): its sticks walk. While its right trigger is pulled they turn the joints of the selected
 * leg instead, and nothing runs without it. STOP ALL is on every gamepad, whatever its mapping.
 *
 * A wireless gamepad that is out of reach looks like one that is held: browsers show its last values for ever. So one
 * whose clock stands still while something is held counts as let go.
 */

import { byId, show, text } from "./dom.js";

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
const WATCH_MS = 50;
/** A hand that holds a stick moves it a little all the time. */
const SILENT_MS = 500;
/** Longer than anybody walks straight on in a room; a shoulder button that is held shows that more is intended. */
const PUSH_MS = 10_000;

export class Pad {
  /**
   * @param {import("./hold.js").Hold} hold @param {import("./targets.js").Targets} targets
   * @param {import("./walk.js").Walk} walk
   * @param {{leg: () => number, stopAll: () => void}} callbacks
   */
  constructor(hold, targets, walk, callbacks) {
    this.hold = hold;
    this.walk = walk;
    this.targets = targets;
    this.callbacks = callbacks;
    this.held = false;
    /** The trigger was released, so its next pull is intended. */
    this.ready = false;
    /** The gamepads whose STOP ALL is pressed; null before the first look. @type {Set<number> | null} */
    this.stopping = null;
    this.pressing = true;
    /** The clock of the gamepad that drives, and when this page last saw it go on. */
    this.clock = { timestamp: NaN, seenMs: 0 };
    /** When its sticks were last in the middle. */
    this.centredMs = 0;
    window.addEventListener("gamepaddisconnected", () => this.#look());
    setInterval(() => this.#look(), WATCH_MS);
  }

  /** Move the selected leg's targets by the sticks. @param {number} elapsedMs */
  steer(elapsedMs) {
    if (!this.held) return;
    const pad = connected();
    if (!pad) {
      this.#look();
      return;
    }
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
    const unusable = pads.filter((pad) => pad.mapping !== "standard").map((pad) => pad.id);
    show(byId("gamepad-unusable"), unusable.length > 0);
    text(byId("gamepad-unusable"), `No gamepad that this browser knows the buttons of: ${unusable.join(", ")}. Its second button is STOP ALL.`);
    const pad = connected();
    show(byId("gamepad"), pad !== null);
    const nowMs = performance.now();
    const why = pad ? this.#whyNot(pad, nowMs) : "the gamepad is disconnected";
    if (!pad || why) {
      this.ready = false;
      if (this.walk.pad.held) this.walk.drop(why);
      this.walk.pad.release();
      if (this.held) {
        this.held = false;
        this.hold.drop(why);
      }
      return;
    }
    text(byId("gamepad-leg"), String(this.callbacks.leg()));
    const pulled = (pad.buttons[TRIGGER]?.value ?? 0) > PRESSED;
    this.#walk(pad, pulled);
    if (!pulled) this.ready = true;
    if (pulled && this.ready && !this.held) {
      this.held = true;
      this.ready = false;
      this.hold.press("gamepad");
    } else if (!pulled && this.held) {
      this.held = false;
      this.hold.release("gamepad");
    }
  }

  /** Why what it holds counts no longer, in words; "" if it counts. @param {Gamepad} pad @param {number} nowMs */
  #whyNot(pad, nowMs) {
    const sticks = pad.axes.some(beyond);
    if (!sticks || SHOULDERS.some((button) => pad.buttons[button]?.pressed)) this.centredMs = nowMs;
    if (pad.timestamp !== this.clock.timestamp) this.clock = { timestamp: pad.timestamp, seenMs: nowMs };
    const holds = sticks || (pad.buttons[TRIGGER]?.value ?? 0) > PRESSED;
    if (holds && nowMs - this.clock.seenMs > SILENT_MS) return "the gamepad sends nothing; let its sticks go, and push again";
    if (nowMs - this.centredMs > PUSH_MS) return `a stick was pushed for ${PUSH_MS / 1000} s; let it go once, or hold a shoulder button`;
    return "";
  }

  /** @param {Gamepad} pad @param {boolean} pulled */
  #walk(pad, pulled) {
    if (pulled) this.walk.pad.release();
    else this.walk.steer(beyond(pad.axes[0]), -beyond(pad.axes[1]), beyond(pad.axes[2]));
    const [stand, sit] = [STAND_BUTTON, SIT_BUTTON].map((button) => pad.buttons[button]?.pressed ?? false);
    if ((stand || sit) && !this.pressing) this.walk.go(sit);
    this.pressing = stand || sit;
  }
}

/** @param {number | undefined} value */
function beyond(value = 0) {
  return Math.abs(value) < DEAD_ZONE ? 0 : value;
}

/** @returns {Gamepad[]} */
function connectedPads() {
  return [...(navigator.getGamepads?.() ?? [])].flatMap((pad) => (pad?.connected ? [pad] : []));
}

/** The one that drives. @returns {Gamepad | null} */
function connected() {
  return connectedPads().find((pad) => pad.mapping === "standard") ?? null;
}
