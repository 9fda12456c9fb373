// @ts-check
/** STOP ALL: one tap, Escape or space, from any place of the page; and its progress in words. */

import { attribute, byId, confirmed, enable, show, text, typesText } from "./dom.js";
import { because, clock, ended, sentence, short, worded } from "./words.js";

/** @typedef {import("./types.js").StopMessage} StopMessage */

const LEGS = 6;
/** A click so soon after a pointer's press belongs to it. */
const SAME_TAP_MS = 1000;
/** If the console is silent for this long after a press, the page connects again. */
const DEAF_MS = 1000;
/** How long a page that was opened may connect before it sends its viewer to the switch. */
const OPENS_MS = 2000;

/** Whether this is the space bar: with Option or AltGr its character is another space. @param {KeyboardEvent} event */
function isSpace(event) {
  return event.key === " " || event.code === "Space";
}

/** Whether a key is STOP ALL: Escape, or space where no text is typed. @param {KeyboardEvent} event */
export function stops(event) {
  return !event.isComposing && (event.key === "Escape" || (isSpace(event) && !typesText(event.target)));
}

/**
 * What the band next to STOP ALL shows: the situation, and the one thing to do next; `reason` is shown by a tap.
 * @param {{looks: boolean, touch: boolean, opens: boolean, cut: import("./words.js").End | null, askedMsAgo: number | null, answer: StopMessage | null,
 *          mode: string, by: string | null, since: string | null, now: string, unconfirmed: string}} known
 *          `opens`: the page was opened a moment ago; `by`: who engaged STOP ALL, and `since` when; `now`: what the robot does, by the console; `unconfirmed`: its
 *          sentence while the power board does not confirm a Stop
 * @returns {{tone: "bad" | "stopped" | "asked" | "plain", line: string, next: string, reason: string}}
 */
export function inWords({ looks, touch, opens, cut, askedMsAgo, answer, mode, by, since, now, unconfirmed }) {
  const asked = askedMsAgo === null ? "" : `asked ${(askedMsAgo / 1000).toFixed(1)} s ago, `;
  const error = answer?.error ?? "";
  if (cut) {
    if (opens && cut.cause === "connecting" && !asked) return { tone: "asked", line: "Connecting …", next: "", reason: "" };
    const { line, next, reason } = ended(cut);
    const waits = asked ? `: ${asked}and asked again once connected` : "";
    return { tone: "bad", line: `NOT CONNECTED: use the switch${waits}`, next: waits ? "" : next, reason: [line, reason].filter(Boolean).join(": ") };
  }
  if (asked && askedMsAgo !== null) {
    const late = askedMsAgo > 500;
    return { tone: late ? "bad" : "asked", line: `${asked}no answer yet${late ? ": use the switch" : ""}`, next: "", reason: error };
  }
  if (unconfirmed) return { tone: "bad", line: unconfirmed, next: "", reason: worded(now) };
  if (mode === "estopped" || answer?.answered) {
    const frames = answer?.stop_frames ?? LEGS;
    if (frames < LEGS) return { tone: "bad", line: `only ${frames} of ${LEGS} Stops written: use the switch`, next: "", reason: "" };
    const within = answer?.latency_us == null ? "" : ` within ${(answer.latency_us / 1000).toFixed(1)} ms`;
    const reason = answer?.answered ? `${frames} Stops written${within}${answer.power ?? ""}` : worded(now);
    const line = `STOPPED${by ? ` by ${short(by)}` : ""}${since ? `, ${clock(since)}` : ""}`;
    return { tone: "stopped", line, next: looks ? "A person who may drive it can reset it." : "When all are clear, reset.", reason };
  }
  if (mode !== "idle" && mode !== "active") return { tone: "bad", line: now.split(":")[0], next: "If it moves, use the switch.", reason: now };
  if (looks) return { tone: "plain", line: "View only: use the power switch", next: "", reason: "" };
  return { tone: "plain", line: touch ? "One tap, at any time" : "Escape or space, at any time", next: "", reason: "" };
}

export class StopAll {
  /**
   * @param {import("./link.js").Link} link @param {import("./model.js").Model} model
   * @param {{pressed: () => void, say: import("./words.js").Say}} callbacks
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
    this.spoken = this.reason = "";
    let pointedMs = -Infinity;
    byId("stop-all").addEventListener("pointerdown", (event) => {
      pointedMs = event.timeStamp;
      this.press(event);
    });
    byId("stop-all").addEventListener("click", (event) => {
      if (event.timeStamp - pointedMs > SAME_TAP_MS) this.press(event); // of a keyboard, or of a screen reader
    });
    byId("reset").addEventListener("click", () => this.#reset());
    byId("stop-known").addEventListener("click", () => {
      const { reason } = this;
      if (reason) callbacks.say(() => (this.reason === reason ? sentence(reason) : ""));
    });
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
    if (ack?.accepted) this.callbacks.say(() => (this.model.runs ? "" : "Reset. Nothing moves until it is started again."));
    else this.callbacks.say(`No reset: ${ack ? because(ack) : message.error}.`);
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
      opens: nowMs < OPENS_MS,
      cut: model.cut(nowMs),
      askedMsAgo: this.asked ? nowMs - this.asked.atMs : null,
      answer: this.answer,
      mode: model.state?.mode ?? "",
      by: latched ? this.#by : "you",
      since: latched ? (model.state?.estop_since ?? null) : null,
      now: model.who(model.now),
      unconfirmed: model.unconfirmed,
    });
    text(byId("stop-line"), known.line);
    text(byId("stop-next"), known.next);
    text(byId("stop-reason"), known.reason);
    this.reason = known.reason;
    enable(byId("stop-known", HTMLButtonElement), known.reason !== "");
    attribute(byId("stop"), "data-tone", known.tone);
    show(byId("reset"), latched && !model.looks && model.live(nowMs));
    enable(byId("stop-all", HTMLButtonElement), !this.#looks);
    const aloud = known.tone === "plain" ? "" : [known.line.replace(/asked [\d.]+ s ago/, "asked"), known.next].filter(Boolean).join(". ");
    if (aloud !== this.spoken) {
      this.spoken = aloud;
      text(byId("stop-aloud"), aloud);
    }
  }

  get #by() {
    const { estop_source: source } = this.model.state ?? {};
    return source == null ? null : this.model.who(source);
  }

  /** An observer cannot stop the robot either. */
  get #looks() {
    return this.model.hello?.role === "observer";
  }

  /** @param {KeyboardEvent} event */
  #key(event) {
    if (!stops(event)) return;
    event.preventDefault();
    if (isSpace(event)) event.stopPropagation(); // it presses no other button
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
