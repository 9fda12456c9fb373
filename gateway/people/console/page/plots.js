// @ts-check
/** The last minute as lines, each with its own dashes and a number at its end. */

import { byId, text } from "./dom.js";
import { HISTORY_MS } from "./model.js";

/** @typedef {import("./model.js").Model} Model */
/** @typedef {{name: string, values: (number | null)[], variable: string, dash: number[]}} Line */

const DASHES = [[], [7, 3], [2, 3], [9, 3, 2, 3], [4, 4], [1, 2]];
const COLOURS = ["--line-1", "--line-2", "--line-3", "--line-4", "--line-5", "--line-6"];
const LEFT = 34;
const RIGHT = 22;
const EDGE = 8;
const EVERY_MS = 200;

export class Plots {
  /** @param {Model} model */
  constructor(model) {
    this.model = model;
    this.angles = byId("plot-angles", HTMLCanvasElement);
    this.ages = byId("plot-ages", HTMLCanvasElement);
    this.drawnMs = 0;
  }

  /** @param {number} nowMs */
  refresh(nowMs) {
    if (nowMs - this.drawnMs < EVERY_MS) return;
    this.drawnMs = nowMs;
    const { history, selectedLeg, state } = this.model;
    text(byId("plot-leg"), String(selectedLeg));
    const joints = [0, 1, 2].map((joint) => ({
      name: String(joint + 1),
      values: history.map((moment) => moment.degrees[(selectedLeg - 1) * 3 + joint]),
      variable: COLOURS[joint],
      dash: DASHES[joint],
    }));
    this.#draw(this.angles, joints, 180, [0, 90, 180], null, nowMs);
    const timeout = state?.watchdog.timeout_ms ?? 250;
    const top = timeout * 1.5;
    const ages = [0, 1, 2, 3, 4, 5].map((leg) => ({
      name: String(leg + 1),
      values: history.map((moment) => (moment.ages[leg] === null || moment.ages[leg] > top ? null : moment.ages[leg])),
      variable: COLOURS[leg],
      dash: DASHES[leg],
    }));
    this.#draw(this.ages, ages, top, [0, timeout], timeout, nowMs);
  }

  /**
   * @param {HTMLCanvasElement} canvas @param {Line[]} lines @param {number} top @param {number[]} ticks
   * @param {number | null} limit @param {number} nowMs
   */
  #draw(canvas, lines, top, ticks, limit, nowMs) {
    const context = canvas.getContext("2d");
    const width = canvas.clientWidth;
    const height = canvas.clientHeight;
    if (!context || !width) return;
    const ratio = devicePixelRatio;
    if (canvas.width !== Math.round(width * ratio)) canvas.width = Math.round(width * ratio);
    if (canvas.height !== Math.round(height * ratio)) canvas.height = Math.round(height * ratio);
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, width, height);
    const style = getComputedStyle(document.documentElement);
    const colour = (/** @type {string} */ name) => style.getPropertyValue(name).trim();
    const x = (/** @type {number} */ atMs) => width - RIGHT - ((nowMs - atMs) / HISTORY_MS) * (width - LEFT - RIGHT);
    const y = (/** @type {number} */ value) => height - EDGE - (value / top) * (height - 2 * EDGE);
    context.font = "11px system-ui, sans-serif";
    context.textBaseline = "middle";
    context.lineWidth = 1;
    for (const tick of ticks) {
      context.strokeStyle = tick === limit ? colour("--stopped") : colour("--faint");
      context.beginPath();
      context.moveTo(LEFT, y(tick));
      context.lineTo(width - RIGHT, y(tick));
      context.stroke();
      context.fillStyle = colour("--muted");
      context.textAlign = "right";
      context.fillText(String(tick), LEFT - 6, y(tick));
    }
    context.textAlign = "left";
    context.lineWidth = 1.6;
    const { history } = this.model;
    /** @type {number[]} */
    const taken = [];
    for (const line of lines) {
      context.strokeStyle = context.fillStyle = colour(line.variable);
      context.setLineDash(line.dash);
      context.beginPath();
      let drawing = false;
      line.values.forEach((value, index) => {
        if (value === null) drawing = false;
        else if (drawing) context.lineTo(x(history[index].atMs), y(value));
        else context.moveTo(x(history[index].atMs), y(value));
        drawing = value !== null;
      });
      context.stroke();
      const last = line.values.at(-1);
      if (last == null) continue;
      let at = y(last);
      while (taken.some((other) => Math.abs(other - at) < 11)) at -= 11; // no name upon another
      taken.push(at);
      context.fillText(line.name, width - RIGHT + 6, Math.max(6, at));
    }
    context.setLineDash([]);
  }
}
