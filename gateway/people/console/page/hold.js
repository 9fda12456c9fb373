// @ts-check
/**
 * Hold to run: while the button, the key H or a gamepad's trigger is held, this page sends the setpoints of the legs that
 * it runs, 20 times a second. Nothing else repeats them. At any obstacle it sends nothing more until something is held
 * anew, and the gateway's watchdog stops the legs.
 *
 * A leg is set only after its `start` was acknowledged, so nothing here starts again a leg that somebody stopped. Where
 * only the whole robot starts and stops, one command starts all six legs, and a Stop of one is one of all.
 */

import { legs as legsInWords } from "./dom.js";
import { LEGS } from "./kinematics.js";
import { because, ended, past } from "./words.js";

/** @typedef {import("./model.js").Model} Model @typedef {import("./types.js").AckMessage} AckMessage */

export const PERIOD_MS = 50;
/** How fast a slider moves a servo at most; a servo by itself is ten times as fast. */
const SPEED_DEG_S = 60;
/** @typedef {{model: Model, callbacks: {mine: () => boolean}, lastTickMs: number}} Driver */

/** Why nothing may be sent, in words; "" if it may. @param {Driver} driver @param {number} nowMs @param {number} lookedMs */
export function obstacle(driver, nowMs, lookedMs = driver.lastTickMs) {
  if (document.visibilityState !== "visible") return "this page is hidden";
  if (!document.hasFocus()) return "this window has lost the focus";
  return barred(driver, nowMs, lookedMs);
}

/**
 * Why it ended, in words that are true later as well: in the past once that has passed.
 * @param {Driver} driver @param {string} why @returns {() => string}
 */
export function cause(driver, why) {
  const is = () => obstacle(driver, performance.now(), driver.model.lookedMs) === why;
  const passes = is();
  return () => (passes && !is() ? past(why) : why);
}

/**
 * Why the robot, or its link, lets this page move nothing, in words; "" if it may: then its controls look so.
 * @param {Driver} driver @param {number} nowMs @param {number} [lookedMs]
 */
export function barred({ model, callbacks }, nowMs, lookedMs) {
  const cut = model.cut(nowMs, lookedMs);
  if (cut) return ended(cut).line;
  if (!model.hello || model.looks) return "this page may only look";
  const mode = model.state?.mode ?? "unknown";
  if (mode === "estopped") return "STOP ALL is engaged; reset it first";
  if (mode !== "idle" && mode !== "active") return `the gateway is not ready (${mode})`;
  if (!callbacks.mine()) return `this page does not have the lease; ${model.toDrive}`;
  return "";
}

/**
 * Call `lose`, with why, as soon as this page must not drive: hidden, without the focus, left or frozen; also while
 * nothing moves, so a thumb that lies on a pad does not count afterwards.
 * @param {Parameters<typeof obstacle>[0]} driver @param {(why: string) => void} lose
 */
export function whenLost(driver, lose) {
  for (const [target, name] of /** @type {[EventTarget, string][]} */ ([
    [window, "blur"],
    [document, "visibilitychange"],
  ])) {
    target.addEventListener(name, () => {
      const why = obstacle(driver, performance.now());
      if (why) lose(why);
    });
  }
  window.addEventListener("pagehide", () => lose("this page was closed or left"));
  document.addEventListener("freeze", () => lose("this page was frozen"));
}

/** Why a command was not accepted, in words; "" if it was. @param {AckMessage} message */
export function whyNot({ ack, error }) {
  if (ack?.accepted) return "";
  return ack ? because(ack) : (error ?? "no answer");
}

/**
 * Starts whose answers are awaited. One that was abandoned before its answer, and is accepted all the same, is stopped
 * again: the Stop may have overtaken it.
 */
export class Starts {
  /** @param {(what: number[]) => void} stop legs or servos */
  constructor(stop) {
    this.stop = stop;
    /** What each starts, by the request's number. @type {Map<number, number[]>} */
    this.waiting = new Map();
    /** @type {Map<number, number[]>} */
    this.abandoned = new Map();
  }

  /** Abandon the starts of this leg or servo; by default all. @param {number} [what] */
  abandon(what) {
    for (const [id, each] of this.waiting) {
      if (what !== undefined && !each.includes(what)) continue;
      this.waiting.delete(id);
      this.abandoned.set(id, each);
    }
  }

  /** @param {AckMessage} message @returns {number[] | undefined} what it answers the start of, if that was not abandoned */
  answered({ id, ack }) {
    const [waiting, abandoned] = [this.waiting.get(id), this.abandoned.get(id)];
    this.waiting.delete(id);
    this.abandoned.delete(id);
    if (abandoned !== undefined && ack?.accepted) this.stop(abandoned);
    return waiting;
  }
}

export class Hold {
  /**
   * @param {import("./link.js").Link} link @param {Model} model
   * @param {{mine: () => boolean, chosen: (by: string) => number[], target: (servo: number, mostDeg: number) => number, busy: () => string,
   *          steer: (elapsedMs: number) => void, say: import("./words.js").Say, begins: () => void, changed: () => void}} callbacks
   */
  constructor(link, model, callbacks) {
    this.link = link;
    this.model = model;
    this.callbacks = callbacks;
    /** What is held, alone: "button", "leg", "key", "gamepad"; "": nothing. What is pressed meanwhile needs a press of its own. */
    this.by = "";
    /** Legs whose start was acknowledged. @type {Set<number>} */
    this.running = new Set();
    this.starts = new Starts((legs) => this.#stop(legs));
    /** Legs that were stopped here while something is held: this hold does not start them again. @type {Set<number>} */
    this.stopped = new Set();
    /** The set whose acknowledgement is awaited. @type {number | null} */
    this.asked = null;
    this.lastTickMs = 0;
    /** @type {ReturnType<typeof setInterval> | undefined} */
    this.timer = undefined;
    /** Legs that were left to the watchdog, until a state shows them stopped. @type {number[]} */
    this.left = [];
    this.why = "";
    whenLost(this, (why) => this.drop(why));
  }

  get active() {
    return this.timer !== undefined;
  }

  /** @param {string} what */
  press(what) {
    if (this.active) return;
    this.lastTickMs = performance.now();
    const why = obstacle(this, this.lastTickMs) || this.callbacks.busy() || (this.callbacks.chosen(what).length ? "" : "choose a leg first");
    if (why) {
      const of = cause(this, why);
      this.callbacks.say(() => `Nothing runs: ${of()}.`);
      return;
    }
    this.left = [];
    this.stopped.clear();
    this.by = what;
    this.timer = setInterval(() => this.#tick(), PERIOD_MS);
    this.callbacks.begins();
    const legs = legsInWords(this.callbacks.chosen(what));
    this.callbacks.say(() => (this.active ? `Running ${legs} while you hold.` : ""));
    this.#startNew();
    this.callbacks.changed();
  }

  /** Let go: what this page ran is stopped at once. @param {string} what */
  release(what) {
    if (!this.active || this.by !== what) return;
    const legs = this.#end();
    if (!legs.length) return;
    const sent = this.#stop(legs);
    this.callbacks.say(sent ? `Let go: ${legsInWords(legs)} stopped.` : "Let go, but not connected: the watchdog stops them.");
  }

  /** Send nothing more until something is held anew. @param {string} why */
  drop(why) {
    if (!this.active) return;
    this.left = this.#end();
    const stops = this.left.length ? ` The watchdog stops ${legsInWords(this.left)}` : "";
    const within = stops && this.model.state ? ` after ${this.model.state.watchdog.timeout_ms} ms.` : "";
    const of = cause(this, why);
    this.callbacks.say(() => `Nothing more is sent: ${of()}.${stops}${within}`);
    this.why = past(why);
  }

  /** Stop legs, also of other clients; that needs no lease. @param {number[]} legs @returns {boolean} whether it was sent */
  stop(legs) {
    for (const leg of this.#together(legs)) this.stopped.add(leg);
    return this.#stop(legs);
  }

  /** The legs that start and stop together with these. @param {number[]} legs @returns {number[]} */
  #together(legs) {
    return this.model.whole && legs.length ? LEGS : legs;
  }

  /** @param {number[]} some */
  #stop(some) {
    const legs = this.#together(some);
    for (const leg of legs) {
      this.running.delete(leg);
      this.starts.abandon(leg);
    }
    const stop = { servos: [{ op: "stop" }, { op: "stop" }, { op: "stop" }] };
    const payload = { legs: Object.fromEntries(legs.map((leg) => [leg, stop])) };
    const id = this.link.nextId();
    return this.link.sendStop({ type: "command", key: "hexapod/legs/cmd", payload, sent_ms: performance.now(), id });
  }

  /** @param {AckMessage} message */
  receivedAck(message) {
    const said = whyNot(message);
    const legs = this.starts.answered(message);
    if (legs !== undefined) {
      if (!said) for (const leg of legs) this.running.add(leg);
      else this.drop(`${legsInWords(legs)} did not start: ${said}`);
    } else if (message.id === this.asked) {
      this.asked = null;
      if (said) this.drop(said);
    }
  }

  /** A new state may show that the legs left to the watchdog have stopped. */
  receivedState() {
    if (!this.left.length) return;
    const legs = this.left.map((leg) => this.model.leg(leg));
    if (legs.some((leg) => leg?.servos.some((servo) => servo.running))) return;
    const watchdog = legs.every((leg) => leg?.watchdog === "expired");
    const stopped = watchdog ? `The watchdog has stopped ${legsInWords(this.left)}` : `Stopped: ${legsInWords(this.left)}`;
    this.callbacks.say(`${stopped}. Reason: ${this.why}.`);
    this.left = [];
  }

  /** The gateway rejected a command of this page, or stopped a leg that it runs. @param {import("./types.js").GatewayEvent} event */
  receivedEvent(event) {
    const stopped = event.kind === "overflow" && event.legs?.some((leg) => this.running.has(leg));
    const rejected = event.kind === "command_rejected" && event.source === this.model.hello?.source;
    if (stopped || rejected) this.drop(because(event));
  }

  /** @returns {number[]} the legs that ran or were about to */
  #end() {
    clearInterval(this.timer);
    this.timer = undefined;
    this.by = "";
    const legs = [...this.#known];
    this.running.clear();
    this.starts.abandon();
    this.asked = null;
    this.callbacks.changed();
    return legs;
  }

  /** The legs that run or are about to. */
  get #known() {
    return new Set([...this.running, ...[...this.starts.waiting.values()].flat()]);
  }

  #tick() {
    const nowMs = performance.now();
    const why = obstacle(this, nowMs);
    const elapsedMs = nowMs - this.lastTickMs;
    this.lastTickMs = nowMs;
    if (why) {
      this.drop(why);
      return;
    }
    this.callbacks.steer(elapsedMs);
    if (!this.active) return; // the gamepad is disconnected
    this.#startNew();
    this.#set();
  }

  /** Start the legs that were chosen, and stop those that are no longer. */
  #startNew() {
    const chosen = new Set(this.callbacks.chosen(this.by));
    const known = this.#known;
    const dismissed = [...known].filter((leg) => !chosen.has(leg));
    if (dismissed.length) this.#stop(dismissed);
    const missing = [...chosen].filter((leg) => !known.has(leg) && !this.stopped.has(leg));
    for (const legs of this.model.whole && missing.length ? [missing] : missing.map((leg) => [leg])) {
      const id = this.link.nextId();
      const command = this.#command(legs, "start");
      this.starts.waiting.set(id, legs);
      const sent = this.link.sendNow({ ...command, id });
      if (!sent) {
        this.drop(ended({ cause: "full" }).line);
        return;
      }
    }
  }

  #set() {
    if (!this.running.size) return;
    const message = this.#command([...this.running], "set");
    if (this.asked === null) message.id = this.asked = this.link.nextId();
    this.link.sendNow(message);
  }

  /** @param {number[]} legs @param {"start" | "set"} op @returns {Record<string, unknown>} */
  #command(legs, op) {
    const mostDeg = SPEED_DEG_S * (PERIOD_MS / 1000);
    const angles = (/** @type {number} */ leg) => ({
      servos: [1, 2, 3].map((joint) => ({ op, angle_deg: this.callbacks.target(leg * 10 + joint, mostDeg) })),
    });
    const message = { type: "command", sent_ms: performance.now() };
    if (op === "start" && !this.model.whole) return { ...message, key: `hexapod/leg/${legs[0]}/cmd`, payload: angles(legs[0]) };
    return { ...message, key: "hexapod/legs/cmd", payload: { legs: Object.fromEntries(legs.map((leg) => [leg, angles(leg)])) } };
  }
}
