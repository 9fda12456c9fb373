// @ts-check
/** A pad for a thumb or a mouse: how far it is from the middle, -1 to 1, while it is held; 0 once it is let go. */

import { byId } from "./dom.js";

const DEAD_ZONE = 0.12;

export class Stick {
  /** @param {string} id @param {boolean} plane whether it goes in both directions, or turns @param {() => void} changed */
  constructor(id, plane, changed) {
    this.place = byId(id);
    this.knob = /** @type {HTMLElement} */ (this.place.querySelector(".knob"));
    this.plane = plane;
    this.x = this.y = this.turn = 0;
    /** @type {number | null} */
    this.pointer = null;
    this.place.addEventListener("pointerdown", (event) => {
      if (event.button !== 0 || this.pointer !== null) return;
      event.preventDefault(); // a mouse selects no text, and a finger scrolls nothing
      this.place.focus({ preventScroll: true });
      this.pointer = event.pointerId;
      this.place.setPointerCapture(event.pointerId);
      this.#move(event);
      changed();
    });
    this.place.addEventListener("pointermove", (event) => {
      if (event.pointerId !== this.pointer) return;
      this.#move(event);
      changed();
    });
    for (const name of ["pointerup", "pointercancel", "lostpointercapture"]) {
      this.place.addEventListener(name, (event) => {
        if (/** @type {PointerEvent} */ (event).pointerId === this.pointer) this.release();
      });
    }
    this.place.addEventListener("contextmenu", (event) => event.preventDefault()); // a long touch
  }

  /** What is held counts no more; it has to be pressed anew. */
  release() {
    this.pointer = null;
    this.x = this.y = this.turn = 0;
    this.#draw(0, 0);
  }

  /** @param {PointerEvent} event */
  #move(event) {
    const { left, top, width, height } = this.place.getBoundingClientRect();
    const reach = (this.plane ? Math.min(width, height) : width) * (this.plane ? 0.33 : 0.4);
    let across = (event.clientX - left - width / 2) / reach;
    let up = this.plane ? (top + height / 2 - event.clientY) / reach : 0;
    const length = Math.hypot(across, up);
    if (length > 1) [across, up] = [across / length, up / length];
    this.#draw(across * reach, -up * reach);
    const counts = length < DEAD_ZONE ? 0 : 1;
    if (this.plane) [this.x, this.y] = [across * counts, up * counts];
    else this.turn = across * counts;
  }

  /** @param {number} x @param {number} y in pixels from the middle */
  #draw(x, y) {
    this.knob.style.transform = `translate(${x.toFixed(1)}px, ${y.toFixed(1)}px)`;
  }
}

/** What a gamepad's sticks say. */
export class Sticks {
  constructor() {
    this.x = this.y = this.turn = 0;
    /** They were seen in the middle, so that their next push is meant. */
    this.centred = false;
  }

  /** @param {number} x @param {number} y @param {number} turn */
  take(x, y, turn) {
    if (!x && !y && !turn) this.centred = true;
    if (this.centred) [this.x, this.y, this.turn] = [x, y, turn];
  }

  /** What is held counts no more; it has to be pushed anew. */
  release() {
    this.centred = false;
    this.x = this.y = this.turn = 0;
  }
}
