// @ts-check
/** W A S D walk, Q and E turn, while they are held. */

import { byId, typesText } from "./dom.js";

/** @type {Record<string, {x: number, y: number, turn: number}>} */
const DIRECTIONS = {
  w: { x: 0, y: 1, turn: 0 },
  s: { x: 0, y: -1, turn: 0 },
  a: { x: -1, y: 0, turn: 0 },
  d: { x: 1, y: 0, turn: 0 },
  q: { x: 0, y: 0, turn: -1 },
  e: { x: 0, y: 0, turn: 1 },
};
/** Part of a full push: a key cannot be pushed half. */
const PART = 0.6;

export class Keys {
  /** @param {() => void} changed */
  constructor(changed) {
    /** @type {Set<string>} */
    this.down = new Set();
    window.addEventListener("keydown", (event) => {
      const key = event.key.toLowerCase();
      const modified = event.ctrlKey || event.altKey || event.metaKey;
      const elsewhere = typesText(event.target) || event.target instanceof HTMLSelectElement;
      if (!(key in DIRECTIONS) || event.repeat || modified || elsewhere) return;
      if (byId("question", HTMLDialogElement).open) return;
      this.down.add(key);
      changed();
    });
    window.addEventListener("keyup", (event) => this.down.delete(event.key.toLowerCase()));
  }

  get x() {
    return this.#sum("x");
  }

  get y() {
    return this.#sum("y");
  }

  get turn() {
    return this.#sum("turn");
  }

  /** What is held no longer counts; it has to be pressed anew. */
  release() {
    this.down.clear();
  }

  /** @param {"x" | "y" | "turn"} of */
  #sum(of) {
    return PART * [...this.down].reduce((all, key) => all + DIRECTIONS[key][of], 0);
  }
}
