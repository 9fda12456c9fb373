// @ts-check
/** STOP ALL: one tap, Escape or space, from any place of the page; and its progress in words. */

import { attribute, byId, confirmed, enable, show, text, typesText, worded } from "./dom.js";
import { because } from "./words.js";

/** @typedef {import("./types.js").StopMessage} StopMessage */

const LEGS = 6;
/** A click so soon after a pointer's press belongs to it. */
const SAME_TAP_MS = 1000;
/** If the console is silent for so long after a press, the page connects again. */
const DEAF_MS = 1000;

/**
 * The progress of a STOP ALL, in one line.
 * @param {{looks: boolean, touch: boolean, connected: boolean, why: string, askedMsAgo: number | null, answer: StopMessage | null,
 *          latched: boolean, now: string, unconfirmed: string}} known   `now`: what the robot does, by the console;
 *          `unconfirmed`: its sentence while the power board does not confirm a Stop
 * @returns {{tone: "bad" | "good" | "asked" | "plain", line: string}}
 */
export function inWords({ looks, touch, connected, why, askedMsAgo, answer, latched, now, unconfirmed }) {
  const asked = askedMsAgo === null ? "" : `asked ${(askedMsAgo / 1000).toFixed(1)} s ago, `;
  if (!connected) {
    const waits = asked ? `${asked}and asked again once connected` : why;
    return { tone: "bad", line: `NOT CONNECTED: use the switch${waits ? ` (${waits})` : ""}` };
  }
  if (askedMsAgo === null && unconfirmed) return { tone: "bad", line: unconfirmed };
  if (looks) return { tone: "plain", line: "View only: use the power switch" };
  if (askedMsAgo !== null) {
    const error = answer?.error ? ` (${answer.error})` : "";
    if (askedMsAgo > 500) return { tone: "bad", line: `${asked}no answer yet: use the switch${error}` };
    return { tone: "asked", line: `${asked}no answer yet${error}` };
  }
  if (answer?.answered && latched) {
    const frames = answer.stop_frames ?? 0;
    if (frames < LEGS) return { tone: "bad", line: `only ${frames} of ${LEGS} Stops written: use the switch` };
    const within = answer.latency_us === null ? "" : ` within ${(answer.latency_us / 1000).toFixed(1)} ms`;
    return { tone: "good", line: `${frames} Stops written${within}${answer.power ?? ""}` };
  }
  if (latched) return { tone: "good", line: worded(now) };
  return { tone: "plain", line: touch ? "One tap, at any time" : "Escape or space, at any time" };
}

export class StopAll {
  /**
   * @param {import("./link.js").Link} link @param {import("./model.js").Model} model
   * @param {{pressed: () => void, say: (line: string) => void}} callbacks
   */
  constructor(link, model, callbacks) {
    this.link = link;
    this.model = model;
    this.callbacks = callbacks;
    /** @type {{id: number, atMs: number} | null} not confirmed yet */
    this.asked = null;
    /** @type {StopMessage | null} */
    this.answer = null;
    this.answeredAtMs = Infinity;
    /** @type {number | null} */
    this.resetId = null;
    this.spoken = "";
    let pointedMs = -Infinity;
    byId("stop-all").addEventListener("pointerdown", (event) => {
      pointedMs = event.timeStamp;
      this.press(event);
    });
    byId("stop-all").addEventListener("click", (event) => {
      if (event.timeStamp - pointedMs > SAME_TAP_MS) this.press(event); // of a keyboard, or of a screen reader
    });
    byId("reset").addEventListener("click", () => this.#reset());
    window.addEventListener("keydown", (event) => this.#key(event), { capture: true });
  }

  /** @param {Event} [event] */
  press(event) {
    event?.preventDefault();
    this.callbacks.pressed();
    if (this.#looks) return;
    if (!this.asked) {
      this.asked = { id: this.link.nextId(), atMs: performance.now() };
      this.answer = null;
    }
    this.link.sendStop({ type: "stop_all", id: this.asked.id });
    this.refresh(performance.now());
  }

  /** The connection is back: request again what is not confirmed. */
  opened() {
    if (this.asked) this.link.sendStop({ type: "stop_all", id: this.asked.id });
  }

  /** @param {StopMessage} message */
  received(message) {
    if (!this.asked || message.id !== this.asked.id) return;
    this.answer = message;
    if (message.answered) {
      this.asked = null;
      this.answeredAtMs = performance.now();
    }
    this.refresh(performance.now());
  }

  /** @param {import("./types.js").AckMessage} message */
  receivedAck(message) {
    if (message.id !== this.resetId) return;
    this.resetId = null;
    const { ack } = message;
    if (ack?.accepted) this.callbacks.say("Reset. Nothing moves until it is started again.");
    else this.callbacks.say(`No reset: ${ack ? because(ack) : message.error}`);
  }

  /** @param {number} nowMs */
  refresh(nowMs) {
    const { model } = this;
    if (this.asked && nowMs - this.asked.atMs > DEAF_MS) this.link.renewIfDeaf(DEAF_MS);
    const latched = model.state?.mode === "estopped";
    if (!latched && model.stateAtMs > this.answeredAtMs) this.answer = null; // it was reset
    const known = inWords({
      looks: this.#looks,
      touch: matchMedia("(pointer: coarse)").matches,
      connected: model.live(nowMs),
      why: model.trouble.split("\n")[0],
      askedMsAgo: this.asked ? nowMs - this.asked.atMs : null,
      answer: this.answer,
      latched: latched || this.answer !== null,
      now: model.now,
      unconfirmed: model.unconfirmed,
    });
    text(byId("stop-known"), known.line);
    attribute(byId("stop"), "data-tone", known.tone);
    show(byId("reset"), latched && !model.looks && model.live(nowMs));
    enable(byId("stop-all", HTMLButtonElement), !this.#looks);
    const aloud = known.tone === "plain" ? "" : known.line.replace(/asked [\d.]+ s ago/, "asked");
    if (aloud !== this.spoken) {
      this.spoken = aloud;
      text(byId("stop-aloud"), aloud);
    }
  }

  /** An observer cannot stop the robot either. */
  get #looks() {
    return this.model.hello?.role === "observer";
  }

  /** @param {KeyboardEvent} event */
  #key(event) {
    const stops = event.key === "Escape" || (event.key === " " && !typesText(event.target));
    if (!stops || event.isComposing) return;
    event.preventDefault();
    if (event.key === " ") event.stopPropagation(); // it presses no other button
    if (!event.repeat) this.press();
  }

  async #reset() {
    const estop = Math.max(this.model.state?.estop ?? 0, this.answer?.estop ?? 0); // the one that is shown now
    const agreed = await confirmed(
      "Leave STOP ALL?",
      "Check that everybody is clear of the robot. Nothing moves until it is started again.",
      "Reset",
      "Stay stopped",
    );
    if (!agreed) return;
    this.resetId = this.link.nextId();
    const sent = this.link.sendNow({ type: "reset", id: this.resetId, estop, sent_ms: performance.now() });
    if (!sent) this.callbacks.say("No reset: not connected.");
  }
}
