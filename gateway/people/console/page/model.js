// @ts-check
/** The page's data: the newest state and its age, the events, and the last minute. */

import { NEUTRAL_DEG } from "./kinematics.js";
import { Feet } from "./measured.js";

/**
 * @typedef {import("./types.js").GatewayState} GatewayState @typedef {import("./types.js").Leg} Leg
 * @typedef {import("./types.js").GatewayEvent} GatewayEvent
 * @typedef {{key: "runs" | "rests" | "stopped" | "waits" | "other", mark: string, word: string}} Status
 * @typedef {{atMs: number, degrees: (number | null)[], ages: (number | null)[]}} Moment
 */

/** A simulated body that is older than this is not shown. */
const BODY_MS = 1000;
/** Nor are measured values. */
const MEASURED_MS = 2000;
export const HISTORY_MS = 60_000;
/** With an older state nothing is sent, and nothing is claimed: states come every 100 ms. */
const FRESH_MS = 500;
/** A page whose timers were late by this was frozen, and so was what it shows. */
const FROZEN_MS = 250;
const MOST_EVENTS = 40;
const MOST_SOURCES = 50;
const RATE_MS = 2000;
/** Most that an event may be older than the newest state and still be news. */
const NEW_MS = 2000;
/** The window whose quickest state gives the difference between the gateway's clock and this page's. */
const WINDOW_MS = 30_000;

/** Two states of one gateway agree on its start to within this. */
const SAME_START_MS = 100;
/** So late at most is a state behind a newer one. */
const LATE_MS = 1000;

/** When its gateway began, by that one's clock. @param {GatewayState} state */
const beganMs = (state) => Date.parse(state.time) - state.uptime_s * 1000;

/** A leg's status, shown by a mark and a word, and only then by colour. @param {Leg} leg @returns {Status} */
function statusOf(leg) {
  const running = leg.servos.some((servo) => servo.running);
  if (leg.watchdog === "expired") return { key: "stopped", mark: "✕", word: "stopped by the watchdog" };
  if (running) return { key: "runs", mark: "▶", word: "runs" };
  if (leg.watchdog === "armed") return { key: "waits", mark: "…", word: "waits to start" };
  if (leg.watchdog === "idle") return { key: "rests", mark: "○", word: "rests" };
  return { key: "other", mark: "?", word: leg.watchdog };
}

/** @type {Status} */
const UNKNOWN = { key: "other", mark: "?", word: "unknown" };

/**
 * Why nobody at this page knows what the robot does. Each line, badge and picture of the page asks this, and so does what it sends.
 * @param {import("./words.js").End | null} cut why the link is cut @param {number} ageMs of the newest state; Infinity: there is none
 * @param {number} stoodMs for how long this page's own clock was not looked at
 * @returns {import("./words.js").End | null} null: the newest state is the present
 */
export function unknown(cut, ageMs, stoodMs) {
  if (stoodMs > FROZEN_MS) return { cause: "frozen", forMs: stoodMs };
  if (cut) return cut;
  if (ageMs < FRESH_MS) return null;
  return ageMs === Infinity ? { cause: "connecting" } : { cause: "old", forMs: ageMs };
}

/** How much later than the quickest one a state came: it waited in a network, or in a frozen page. */
export class Lateness {
  constructor() {
    this.uptimeMs = 0;
    this.turnedAtMs = 0;
    this.least = Infinity;
    this.leastBefore = Infinity;
  }

  /** @param {number} uptimeMs the gateway's clock @param {number} atMs this page's, when it received the state */
  received(uptimeMs, atMs) {
    if (uptimeMs < this.uptimeMs || this.least === Infinity) {
      this.least = this.leastBefore = Infinity; // another run of the gateway
      this.turnedAtMs = atMs;
    } else if (atMs - this.turnedAtMs > WINDOW_MS) {
      this.leastBefore = this.least; // clocks drift apart, so the past is forgotten
      this.least = Infinity;
      this.turnedAtMs = atMs;
    }
    this.uptimeMs = uptimeMs;
    const apart = atMs - uptimeMs;
    this.least = Math.min(this.least, apart);
    return apart - Math.min(this.least, this.leastBefore);
  }
}

/** The verbs of the gateway's sentences about one person, where that is "you". @type {Record<string, string>} */
const YOURS = { asks: "ask", has: "have", was: "were" };

export class Model {
  constructor() {
    /** @type {import("./types.js").Hello | null} */
    this.hello = null;
    /** @type {GatewayState | null} */
    this.state = null;
    /** What the robot does according to it, in one sentence of the console's. */
    this.now = "";
    /** How the power board feeds the servos, by the console; empty without one. */
    this.power = "";
    /** The console's sentence while the power board does not confirm a Stop. */
    this.unconfirmed = "";
    /** When the state was true, by this page's clock. */
    this.stateAtMs = -Infinity;
    /** When this page last looked at its clocks: its own, which stands still while its machine sleeps, and the wall's. */
    this.lookedMs = performance.now();
    this.wallMs = Date.now();
    /** For how long in all its machine slept. */
    this.sleptMs = 0;
    this.connected = false;
    /** Why it is not. @type {import("./words.js").End} */
    this.end = { cause: "connecting" };
    /** The console's link to the gateway; *connecting* until the console has sent it. @type {import("./types.js").LinkMessage} */
    this.gateway = { type: "link", status: "connecting", detail: "" };
    /** @type {GatewayEvent[]} newest first */
    this.events = [];
    /** @type {Map<string, {count: number, reason: string}>} */
    this.rejections = new Map();
    /** @type {Moment[]} oldest first */
    this.history = [];
    /** @type {{atMs: number, frames: number}[]} */
    this.frames = [];
    this.lateness = new Lateness();
    /** The last angle that each servo was commanded to, also while it rests. @type {Map<number, number>} */
    this.lastDeg = new Map();
    this.selectedLeg = 1;
    /** Where a robot is that is simulated with physics. @type {import("./types.js").Body | null} */
    this.newestBody = null;
    this.bodyAtMs = -Infinity;
    /** Whether its six legs start and stop only together. */
    this.whole = false;
    /** @type {import("./types.js").Telemetry | null} */
    this.telemetry = null;
    this.measuredAtMs = -Infinity;
    this.feet = new Feet();
    /** @type {boolean[] | null} */
    this.carry = null;
  }

  /** @param {import("./types.js").Telemetry} telemetry @param {number} nowMs */
  takeTelemetry(telemetry, nowMs) {
    this.telemetry = telemetry;
    this.measuredAtMs = nowMs - telemetry.age_ms;
    this.carry = telemetry.feet ? this.feet.carry(telemetry.feet) : null;
  }

  /** What the robot measures now. @param {number} nowMs */
  measured(nowMs) {
    return this.live(nowMs) && nowMs - this.measuredAtMs < MEASURED_MS ? this.telemetry : null;
  }

  /** Whether this leg's foot carries; null: that is not measured. @param {number} leg @param {number} nowMs */
  carries(leg, nowMs) {
    return this.measured(nowMs) ? (this.carry?.[leg - 1] ?? null) : null;
  }

  /** @param {import("./types.js").Body} body @param {number} nowMs */
  takeBody(body, nowMs) {
    this.newestBody = body;
    this.bodyAtMs = nowMs;
  }

  /** @param {number} nowMs */
  body(nowMs) {
    return this.live(nowMs) && this.state?.physics && nowMs - this.bodyAtMs < BODY_MS ? this.newestBody : null;
  }

  /** Age of the newest state. @param {number} nowMs */
  ageMs(nowMs) {
    return nowMs - this.stateAtMs;
  }

  /** What cuts this page off from the robot; null: nothing does. @param {number} nowMs @param {number} lookedMs when its clock was last looked at */
  cut(nowMs, lookedMs = this.lookedMs) {
    const { status, detail } = this.gateway;
    const cut = !this.connected ? this.end : status === "connected" ? null : { cause: status, detail };
    return unknown(cut, this.ageMs(nowMs), nowMs - lookedMs);
  }

  /** Look at the clocks: ten times a second. @param {number} nowMs @param {number} wallMs */
  look(nowMs, wallMs) {
    const sleptMs = wallMs - this.wallMs - (nowMs - this.lookedMs);
    if (sleptMs > FROZEN_MS) [this.stateAtMs, this.sleptMs] = [this.stateAtMs - sleptMs, this.sleptMs + sleptMs];
    [this.lookedMs, this.wallMs] = [nowMs, wallMs];
  }

  /** Whether what is shown is the present. @param {number} nowMs */
  live(nowMs) {
    return this.cut(nowMs) === null;
  }

  /** Who commands, drives or has stopped the robot, by its newest state and events. */
  get names() {
    const { legs = [], lease, estop_source: stopper } = this.state ?? {};
    return [...[...legs, ...this.events].map(({ source }) => source), lease?.holder, stopper].flatMap((name) => (name ? [name] : []));
  }

  /** This page's own names are "you" to its viewer. @param {string} said a name, or a sentence with names */
  who(said) {
    const named = (this.hello?.names ?? []).reduce((all, name) => all.replaceAll(`${name} walks`, "you").replaceAll(name, "you"), said);
    return named.startsWith("you ") ? named.replace(/\b(asks|has|was)\b/g, (verb) => YOURS[verb]) : named;
  }

  /** Whether a servo runs or waits to be started, as far as is known. */
  get runs() {
    return this.state?.legs.some((leg) => leg.watchdog === "armed" || leg.servos.some((servo) => servo.running)) ?? false;
  }

  /** Whether this page may move nothing; a button's page can stop. */
  get looks() {
    return this.hello !== null && this.hello.role !== "operator";
  }

  get geometry() {
    return this.hello?.geometry ?? null;
  }

  /** @param {number} leg */
  leg(leg) {
    return this.state?.legs.find((each) => each.leg === leg) ?? null;
  }

  /** A leg's status now. @param {number} leg @param {number} nowMs @returns {Status} */
  status(leg, nowMs) {
    const known = this.leg(leg);
    return known && this.live(nowMs) ? statusOf(known) : UNKNOWN;
  }

  /** Whether the lease waits for this page, or for another of its person. */
  get handed() {
    const { holder = null, held_s } = this.state?.lease ?? {};
    return holder !== null && (holder === this.hello?.source || holder === this.hello?.person) && held_s === null;
  }

  /** How a page without the lease gets it. @returns {"press Drive" | "ask for it"} */
  get toDrive() {
    return (this.state?.lease?.holder ?? null) === null || this.handed ? "press Drive" : "ask for it";
  }

  /** A leg's three angles as last commanded; a servo without a command is drawn at its neutral angle. @param {number} leg */
  degrees(leg) {
    return [1, 2, 3].map((joint) => this.lastDeg.get(leg * 10 + joint) ?? NEUTRAL_DEG);
  }

  /**
   * Returns whether the gateway was started again since the state before; a clock that is set is no such start.
   * @param {GatewayState} state @param {number} ageMs at the console @param {number} nowMs
   */
  takeState(state, ageMs, nowMs) {
    const apart = this.state !== null && Math.abs(beganMs(state) - beganMs(this.state)) >= SAME_START_MS;
    const restarted = apart && state.uptime_s * 1000 < nowMs - this.stateAtMs + LATE_MS;
    if (apart) this.frames = [];
    this.state = state;
    this.stateAtMs = nowMs - ageMs - this.lateness.received(state.uptime_s * 1000, nowMs - ageMs);
    for (const leg of state.legs) {
      for (const servo of leg.servos) if (servo.angle_deg !== null) this.lastDeg.set(servo.id, servo.angle_deg);
    }
    this.history.push({
      atMs: this.stateAtMs,
      degrees: state.legs.flatMap((leg) => leg.servos.map((servo) => servo.angle_deg)),
      ages: state.legs.map((leg) => leg.age_ms),
    });
    while (this.history.length > 1 && this.history[0].atMs < nowMs - HISTORY_MS) this.history.shift();
    this.frames.push({ atMs: this.stateAtMs, frames: state.spi.frames });
    while (this.frames.length > 2 && this.frames[1].atMs < nowMs - RATE_MS) this.frames.shift();
    return restarted;
  }

  /** Forget what the console sends again on each connection. */
  forgetEvents() {
    this.events = [];
    this.rejections.clear();
  }

  /** @param {GatewayEvent} event with its tone */
  takeEvent(event) {
    this.events.unshift(event);
    this.events.length = Math.min(this.events.length, MOST_EVENTS);
    if (event.kind !== "command_rejected") return;
    const source = event.source ?? "(no name)";
    const before = this.rejections.get(source)?.count ?? 0;
    if (before || this.rejections.size < MOST_SOURCES) {
      const count = before + 1 + (event.left_out ?? 0);
      this.rejections.set(source, { count, reason: event.reason ?? "?" });
    }
  }

  /** Whether it was reported just now; a page that opens is sent older ones as well. @param {GatewayEvent} event */
  isNew(event) {
    return this.state !== null && Date.parse(event.time) > Date.parse(this.state.time) - NEW_MS;
  }

  /** Frames a second over the last two seconds, or null. */
  framesPerSecond() {
    const first = this.frames.at(0);
    const last = this.frames.at(-1);
    if (!first || !last || last.atMs <= first.atMs) return null;
    return ((last.frames - first.frames) * 1000) / (last.atMs - first.atMs);
  }
}
