// @ts-check
/**
 * A gamepad (standard mapping): its sticks walk. While its right trigger is pulled they turn the joints of the selected
 * leg instead, and nothing runs without it.
 */

import { byId, show, text } from "./dom.js";

const TRIGGER = 7;
const STAND_BUTTON = 0;
const STOP_BUTTON = 1;
const SIT_BUTTON = 2;
const PRESSED = 0.5;
const DEAD_ZONE = 0.15;
const SPEED_DEG_S = 60;
/** Left stick sideways, left stick up and down, right stick up and down: joints 1, 2 and 3. */
const AXES = [0, 1, 3];
const WATCH_MS = 50;

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
    this.stopping = true;
    this.pressing = true;
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
    const pad = connected();
    show(byId("gamepad"), pad !== null);
    if (!pad) {
      this.ready = false;
      this.walk.pad.release();
      if (this.held) {
        this.held = false;
        this.hold.drop("the gamepad is disconnected");
      }
      return;
    }
    text(byId("gamepad-leg"), String(this.callbacks.leg()));
    const stops = pad.buttons[STOP_BUTTON]?.pressed ?? false;
    if (stops && !this.stopping) this.callbacks.stopAll();
    this.stopping = stops;
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

/** @returns {Gamepad | null} */
function connected() {
  for (const pad of navigator.getGamepads?.() ?? []) if (pad?.connected && pad.mapping === "standard") return pad;
  return null;
}
