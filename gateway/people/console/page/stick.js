// @ts-check
/**
 * A pad for a thumb or a mouse: how far it is pushed from where it landed, -1 to 1, while it is held, else 0. So a pad
 * that moves under a thumb changes no direction; it is let go all the same, since the person did not intend that.
 */

import { byId } from "./dom.js";

const DEAD_ZONE = 0.12;

export class Stick {
  /**
   * @param {string} id @param {boolean} plane whether it goes in both directions, or turns
   * @param {() => void} changed @param {(why: string) => void} lost what is held no longer counts
   */
  constructor(id, plane, changed, lost) {
    this.place = byId(id);
    this.knob = /** @type {HTMLElement} */ (this.place.querySelector(".knob"));
    this.plane = plane;
    this.x = this.y = this.turn = 0;
    /** @type {number | null} */
    this.pointer = null;
    this.lost = lost;
    /** Where the thumb landed, in pixels of the window, and how far full speed is from there. */
    this.landed = { x: 0, y: 0, reach: 1 };
    /** The pad's box and the window's then. */
    this.box = "";
    this.place.addEventListener("pointerdown", (event) => {
      if (event.button !== 0 || this.pointer !== null) return;
      event.preventDefault(); // a mouse selects no text, and a finger scrolls nothing
      this.place.focus({ preventScroll: true });
      this.pointer = event.pointerId;
      this.place.setPointerCapture(event.pointerId);
      const { width, height } = this.place.getBoundingClientRect();
      const reach = plane ? Math.min(width, height) * 0.33 : width * 0.4;
      this.landed = { x: event.clientX, y: event.clientY, reach };
      this.box = this.#box();
      this.#move(event);
    });
    this.place.addEventListener("pointermove", (event) => {
      if (event.pointerId !== this.pointer) return;
      this.check();
      if (this.pointer === null) return;
      this.#move(event);
      changed();
    });
    this.place.addEventListener("pointerup", (event) => {
      if (event.pointerId === this.pointer) this.release();
    });
    for (const name of ["pointercancel", "lostpointercapture"]) {
      this.place.addEventListener(name, (event) => {
        if (/** @type {PointerEvent} */ (event).pointerId === this.pointer) lost("the system took the touch");
      });
    }
    for (const target of [window, window.visualViewport]) target?.addEventListener("resize", () => this.check());
    document.addEventListener("scroll", () => this.check(), { capture: true });
    this.place.addEventListener("contextmenu", (event) => event.preventDefault()); // a long touch
  }

  /** What is held no longer counts; it has to be pressed anew. */
  release() {
    this.pointer = null;
    this.x = this.y = this.turn = 0;
    this.knob.style.transform = "";
  }

  /** If the pad has moved since the thumb landed, what is held no longer counts. */
  check() {
    if (this.pointer !== null && this.box !== this.#box()) this.lost("the page moved under the thumb");
  }

  #box() {
    const { left, top, width, height } = this.place.getBoundingClientRect();
    return [left, top, width, height, innerWidth, innerHeight, window.visualViewport?.scale, screen.orientation?.angle].join();
  }

  /** @param {PointerEvent} event */
  #move(event) {
    const { x, y, reach } = this.landed;
    let across = (event.clientX - x) / reach;
    let up = this.plane ? (y - event.clientY) / reach : 0;
    const length = Math.hypot(across, up);
    if (length > 1) [across, up] = [across / length, up / length];
    this.#draw(across * reach, -up * reach);
    const counts = length < DEAD_ZONE ? 0 : 1;
    if (this.plane) [this.x, this.y] = [across * counts, up * counts];
    else this.turn = across * counts;
  }

  /** @param {number} x @param {number} y in pixels from where the thumb landed */
  #draw(x, y) {
    const { left, top, width, height } = this.place.getBoundingClientRect();
    const across = this.landed.x - left - width / 2 + x;
    const down = this.plane ? this.landed.y - top - height / 2 + y : 0;
    this.knob.style.transform = `translate(${across.toFixed(1)}px, ${down.toFixed(1)}px)`;
  }
}

/** A gamepad's sticks, -1 to 1. */
export class Sticks {
  constructor() {
    this.x = this.y = this.turn = 0;
    /** They were in the middle, so their next push is intended. */
    this.centred = false;
  }

  /** @param {number} x @param {number} y @param {number} turn */
  take(x, y, turn) {
    if (!x && !y && !turn) this.centred = true;
    if (this.centred) [this.x, this.y, this.turn] = [x, y, turn];
  }

  /** What is held no longer counts; it has to be pushed anew. */
  release() {
    this.centred = false;
    this.x = this.y = this.turn = 0;
  }
}
