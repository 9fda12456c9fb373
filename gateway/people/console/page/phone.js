// @ts-check
/** A phone keeps its screen on, shakes, and fills its screen with the page. */

import { attribute, show } from "./dom.js";

export const TAP_MS = [60];
/** Something that the person wanted does not go on. */
export const LOST_MS = [80, 60, 80];

/** iPhones do not shake for a page. @param {number[]} pattern of shaking and pauses, in ms */
export function shake(pattern) {
  navigator.vibrate?.(pattern);
}

/** A screen that stays on while that is wanted, and the page is seen: a browser lets go of it when the page is hidden. */
export class Awake {
  constructor() {
    this.wanted = false;
    /** @type {WakeLockSentinel | null} */
    this.lock = null;
    document.addEventListener("visibilitychange", () => this.#ask());
  }

  /** Whether the browser has agreed. */
  get on() {
    return this.lock !== null;
  }

  /** @param {boolean} wanted */
  want(wanted) {
    if (wanted === this.wanted) return;
    this.wanted = wanted;
    if (wanted) this.#ask();
    else void this.lock?.release();
  }

  #ask() {
    if (!this.wanted || document.visibilityState !== "visible") return;
    void navigator.wakeLock
      ?.request("screen")
      .then((lock) => {
        this.lock = lock;
        lock.addEventListener("release", () => this.lock === lock && (this.lock = null));
        if (!this.wanted) void lock.release();
      })
      .catch(() => {});
  }
}

/** Only a tap or a click may ask for it. */
export function fillScreen() {
  void document.documentElement.requestFullscreen?.().catch(() => {});
}

/**
 * A button for the full screen, where there is one and no mouse: Escape is STOP ALL, and in a full screen the browser
 * keeps that key for itself. So where a keyboard has been used, leaving it without the button counts as Escape.
 * @param {HTMLElement} button @param {() => void} escaped
 */
export function offerFullScreen(button, escaped) {
  let [keys, leaves] = [false, false];
  show(button, document.fullscreenEnabled && !matchMedia("(any-pointer: fine)").matches);
  window.addEventListener("keydown", () => (keys = true), { capture: true });
  button.addEventListener("click", () => {
    leaves = document.fullscreenElement !== null;
    if (leaves) void document.exitFullscreen();
    else fillScreen();
  });
  document.addEventListener("fullscreenchange", () => {
    const full = document.fullscreenElement !== null;
    attribute(button, "aria-pressed", String(full));
    if (!full && keys && !leaves) escaped();
    leaves = false;
  });
}
