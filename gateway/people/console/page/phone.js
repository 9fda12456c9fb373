// @ts-check
/** A phone's screen lock, vibration and full screen. */

import { attribute, show } from "./dom.js";

export const TAP_MS = [60];
/** What the person holds no longer counts. */
export const LOST_MS = [80, 60, 80];

/** Vibrate, which iPhones do for no page. @param {number[]} pattern of vibrations and pauses, in ms */
export function shake(pattern) {
  navigator.vibrate?.(pattern);
}

/** Keeps the screen on while that is wanted and the page is visible: a browser ends it for a hidden page. */
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

/** Only a tap or a click may ask for it. Not where there is a mouse, and perhaps a keyboard: Escape would only leave it. */
export function fillScreen() {
  if (matchMedia("(any-pointer: fine)").matches) return;
  void document.documentElement.requestFullscreen?.().catch(() => {});
}

/**
 * A button for the full screen, if the browser has one and there is no mouse. Escape is STOP ALL, but leaves the full
 * screen instead; so once a keyboard has been used, leaving it without the button counts as Escape.
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
