// @ts-check
/** The keys at the places of W A S D walk, and those of Q and E turn, while they are held. */

import { byId, typesText } from "./dom.js";

/** By the keys' places, which are the same whatever alphabet is typed. @type {Record<string, {x: number, y: number, turn: number}>} */
const DIRECTIONS = {
  KeyW: { x: 0, y: 1, turn: 0 },
  KeyS: { x: 0, y: -1, turn: 0 },
  KeyA: { x: -1, y: 0, turn: 0 },
  KeyD: { x: 1, y: 0, turn: 0 },
  KeyQ: { x: 0, y: 0, turn: -1 },
  KeyE: { x: 0, y: 0, turn: 1 },
};
/** Part of a full push: a key cannot be pushed half. */
const PART = 0.6;

/** The key's place, or its letter on a keyboard without places, such as a remote desktop's. @param {KeyboardEvent} event */
export function placeOf(event) {
  return event.code || `Key${event.key.toUpperCase()}`;
}

/**
 * Call `released` with the place of each key that is let go, or null: all are. With AltGr, Option or another layout the key's
 * letter is another one by then. macOS reports no release while Command is held, so Command counts as the release of all keys.
 * @param {(place: string | null) => void} released
 */
export function whenReleased(released) {
  for (const name of /** @type {const} */ (["keydown", "keyup"])) {
    window.addEventListener(name, (event) => {
      if (event.key === "Meta") released(null);
      else if (name === "keyup") released(placeOf(event));
    });
  }
}

export class Keys {
  /** @param {() => void} changed */
  constructor(changed) {
    /** The places of the keys that are held. @type {Set<string>} */
    this.down = new Set();
    window.addEventListener("keydown", (event) => {
      const place = placeOf(event);
      const modified = event.ctrlKey || event.altKey || event.metaKey;
      const elsewhere = typesText(event.target) || event.target instanceof HTMLSelectElement;
      if (!(place in DIRECTIONS) || event.repeat || modified || elsewhere) return;
      if (byId("question", HTMLDialogElement).open) return;
      this.down.add(place);
      changed();
    });
    whenReleased((place) => (place === null ? this.release() : this.down.delete(place)));
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
    return PART * [...this.down].reduce((all, place) => all + DIRECTIONS[place][of], 0);
  }
}
