// @ts-check
/** The link's quality: the worst delay of the last two seconds, in milliseconds and bars. */

const WINDOW_MS = 2000;
/** States come every 100 ms; wishes that take 250 ms are silence, and at a state of 500 ms nothing is sent (`hold.js`). */
const WORST_MS = [500, 300, 200];

export class Quality {
  constructor() {
    /** @type {{atMs: number, ms: number}[]} */
    this.seen = [];
  }

  /**
   * @param {number} nowMs @param {number} ageMs of the newest state; Infinity: not known @param {number} answerMs how long a wish took; NaN: none
   * @returns {{bars: number, known: string}} no bars: nothing may move
   */
  take(nowMs, ageMs, answerMs) {
    if (ageMs === Infinity) this.seen = [];
    if (ageMs === Infinity) return { bars: 0, known: "no link" };
    this.seen.push({ atMs: nowMs, ms: Math.max(ageMs, answerMs || 0) });
    while (this.seen[0].atMs < nowMs - WINDOW_MS) this.seen.shift();
    const worstMs = Math.max(...this.seen.map(({ ms }) => ms));
    const bars = WORST_MS.filter((ms) => worstMs < ms).length;
    return { bars, known: `${Math.round(worstMs / 10) * 10} ms` };
  }
}
