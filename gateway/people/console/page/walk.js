// @ts-check
/**
 * Walking: while the pad, a key or a stick is held, this page sends a wish 20 times a second. The console uses each wish
 * once; when this page falls silent, the robot finishes its step and stands, and later sits down.
 *
 * Each wish carries the number of its press. What ends a walk uses up that press: then something has to be pressed anew.
 */

import { attribute, byId, element, enable, show, text } from "./dom.js";
import { barred, cause, obstacle, PERIOD_MS, whenLost } from "./hold.js";
import { Keys } from "./keys.js";
import { LOST_MS, shake } from "./phone.js";
import { Stick } from "./stick.js";
import { plain, sentence, worded } from "./words.js";

/** @typedef {import("./types.js").WalkMessage} WalkMessage @typedef {import("./stick.js").Sticks} Sticks
 * @typedef {{x: number, y: number, turn: number}} Deflection @typedef {Deflection & {release: () => void}} Control */

const SPEED_M_S = 0.1;
const TURN_RAD_S = 0.4;
/** Parts of the fastest: the velocity of a pad, stick or key that is pushed to its end. @type {Record<string, number>} */
const PARTS = { slow: 0.4, fast: 1 };
const STEP_M = 0.01;
const USUAL_M = 0.15;
/** How long after a press the console may take to report the walk. */
const BEGINS_MS = 6000;

export class Walk {
  /**
   * @param {import("./link.js").Link} link @param {import("./model.js").Model} model
   * @param {{mine: () => boolean, old: () => boolean, busy: () => string, say: import("./words.js").Say}} callbacks
   *   `busy`: what else drives the legs, in words, or ""; `old`: whether the camera's picture is too old to drive by
   */
  constructor(link, model, callbacks) {
    this.link = link;
    this.model = model;
    this.callbacks = callbacks;
    /** The newest press; 0: none. */
    this.press = 0;
    this.sits = true;
    this.gait = "tripod";
    /** A page always begins with the slow speed. */
    this.speed = "slow";
    /** @type {number | null} */
    this.heightM = null;
    /** @type {WalkMessage | null} */
    this.report = null;
    this.lastTickMs = 0;
    this.pressedMs = -Infinity;
    /** Whether the page has shown why what is held no longer counts. */
    this.dropped = false;
    /** @type {ReturnType<typeof setInterval> | undefined} */
    this.timer = undefined;
    /** Whether a walk that the page before this one began stands here until something is pressed. */
    this.goesOn = false;
    /** When each wish was sent whose use is not reported yet. @type {Map<number, number>} */
    this.sentMs = new Map();
    this.answerMs = NaN;
    const [touched, lost] = [() => this.#held(this.touch), (/** @type {string} */ why) => this.drop(why)];
    /** What drives as one: two thumbs, the keys, or one gamepad's sticks. */
    this.touch = [new Stick("pad", true, touched, lost), new Stick("turn", false, touched, lost)];
    this.keys = [new Keys(() => this.#held(this.keys))];
    /** What was pressed while nothing else was held. @type {Control[] | null} */
    this.driver = null;
    byId("stand").addEventListener("click", () => this.go(false));
    byId("sit").addEventListener("click", () => this.go(true));
    byId("lower").addEventListener("click", () => this.#rise(-STEP_M));
    byId("higher").addEventListener("click", () => this.#rise(STEP_M));
    for (const input of this.#choices("speed")) input.addEventListener("change", () => (this.speed = input.value));
    whenLost(this, (why) => this.drop(why));
  }

  /** Show these gaits to choose from. @param {string[]} gaits */
  offer(gaits) {
    const choices = gaits.map((gait) => {
      const input = element("input", { type: "radio", name: "gait", id: `gait-${gait}`, value: gait });
      input.addEventListener("change", () => {
        this.gait = gait;
        if (this.active) this.#press(false);
      });
      return element("label", {}, input, element("span", {}, gait));
    });
    byId("gaits").replaceChildren(...choices);
  }

  /** The page was loaded anew: go on standing, and count on. @param {number} lastId of the page before; 0: there was none */
  goOn(lastId) {
    this.link.lastId = Math.max(this.link.lastId, lastId);
    this.goesOn = lastId > 0;
  }

  /** Whether this page makes the robot stand or walk, or is about to. */
  get active() {
    return this.timer !== undefined;
  }

  /** Its velocity: forward and left in m/s, and the turn in rad/s. @returns {number[]} */
  get going() {
    return this.report?.posture === "walking" && this.model.live(performance.now()) ? this.report.scaled : [0, 0, 0];
  }

  /** What drives: pressed while nothing else was held, and held since. */
  get driving() {
    if (!this.driver?.some(moves)) this.driver = null;
    return this.driver;
  }

  /** How far what drives is pushed. @returns {Deflection} */
  get deflection() {
    const sum = (/** @type {"x" | "y" | "turn"} */ of) => (this.driving ?? []).reduce((all, each) => all + each[of], 0);
    const [x, y] = [sum("x"), sum("y")];
    const length = Math.max(1, Math.hypot(x, y));
    return { x: x / length, y: y / length, turn: Math.max(-1, Math.min(1, sum("turn"))) };
  }

  /** Stand, or sit. @param {boolean} sits */
  go(sits) {
    this.#press(sits);
  }

  /** Take a gamepad's sticks, -1 to 1. @param {Sticks[]} pad @param {number} x @param {number} y @param {number} turn */
  steer(pad, x, y, turn) {
    pad[0].take(x, y, turn);
    this.#held(pad);
  }

  /** What is held no longer counts; something has to be pressed anew. @param {string} why */
  drop(why) {
    const moved = this.driving !== null;
    this.#letGo();
    if (!this.active || !moved) return;
    this.dropped = true;
    shake(LOST_MS);
    const rises = this.report?.posture === "moving"; // and goes on until it stands
    const does = rises ? "What is held no longer counts" : "It stands still";
    const of = cause(this, why);
    this.callbacks.say(() => `${this.model.live(performance.now()) ? does : "This page no longer moves it"}: ${of()}.`);
  }

  /** The connection to the console ended, or STOP ALL was pressed: the walk is over here. @param {string} why */
  end(why) {
    this.drop(why);
    clearInterval(this.timer);
    this.timer = undefined;
    this.report = null;
    this.refresh();
  }

  /** @param {WalkMessage} message */
  received(message) {
    if (message.press < this.press && message.posture === null && !message.detail) return; // of a walk before
    if (this.goesOn && message.posture !== null && this.callbacks.mine()) this.#stand(message);
    const before = this.report;
    this.report = message.posture === null ? null : message;
    const at = message.id === null ? undefined : this.sentMs.get(message.id);
    if (at !== undefined && message.id !== null) {
      this.answerMs = performance.now() - at;
      for (const id of this.sentMs.keys()) if (id <= message.id) this.sentMs.delete(id);
    }
    if (message.detail && message.detail !== before?.detail) {
      this.callbacks.say(sentence(worded(this.model.who(plain(message.detail))), this.model.names));
      if (message.posture !== null && this.heightM !== null) this.heightM = message.height_m;
    } else if (message.limit && message.limit !== before?.limit) {
      const line = `${message.scaled.some(Boolean) ? "Slower than that" : "It stands still"}: ${message.limit}.`;
      this.callbacks.say(() => (this.report?.limit === message.limit ? line : ""));
    } else if (message.now && message.now !== before?.now && !(this.dropped && message.posture === "standing")) {
      this.callbacks.say(() => (this.model.live(performance.now()) && this.report?.now === message.now ? `${worded(this.model.who(message.now))}.` : ""));
    }
    if (message.waits && message.press === this.press && message.posture !== null && !this.sits) {
      if (message.detail) this.#letGo();
      else this.drop("the console received nothing of this page for a moment");
    }
    if (message.posture === null && message.press >= this.press) {
      this.#letGo();
      clearInterval(this.timer);
      this.timer = undefined;
      if (before && !message.detail) this.callbacks.say("It sits, and its servos are stopped.");
    }
    this.refresh();
  }

  refresh(nowMs = performance.now()) {
    const { report } = this;
    const { x, y, turn } = this.deflection;
    const may = barred(this, nowMs) === "";
    show(byId("walk-controls"), !this.model.looks);
    for (const id of ["stand", "sit", "lower", "higher"]) enable(byId(id, HTMLButtonElement), may);
    for (const id of ["pad", "turn"]) attribute(byId(id), "aria-disabled", may && !this.callbacks.old() ? "false" : "true");
    for (const input of [...this.#choices("gait"), ...this.#choices("speed")]) enable(input, may);
    attribute(byId("pad"), "data-held", x || y ? "yes" : "no");
    attribute(byId("turn"), "data-held", turn ? "yes" : "no");
    text(byId("height"), `${Math.round((report?.height_m ?? this.heightM ?? USUAL_M) * 100)} cm`);
    for (const input of this.#choices("gait")) input.checked = input.value === this.gait;
    for (const input of this.#choices("speed")) input.checked = input.value === this.speed;
    text(byId("walk-known"), this.#known(nowMs));
  }

  /** @param {number} nowMs */
  #known(nowMs) {
    const { report } = this;
    if (!report && !this.active) return "This page does not walk the robot.";
    if (!this.model.live(nowMs)) return "What it does is not known.";
    if (!report) return "It begins …";
    const known = `${worded(this.model.who(report.now))}, ${report.gait}`;
    if (report.posture !== "walking") return known;
    const [forward, left, turn] = report.scaled;
    const turns = Math.round((turn * 180) / Math.PI);
    const way = turns ? `, ${Math.abs(turns)}°/s to the ${turns > 0 ? "left" : "right"}` : "";
    return `${known}, ${Math.hypot(forward, left).toFixed(2)} m/s${way}`;
  }

  /** Nothing is pressed, and this page only shows that it is there. @param {WalkMessage} message */
  #stand({ press, gait, height_m }) {
    [this.press, this.sits, this.goesOn, this.heightM] = [press, false, false, height_m];
    this.gait = gait ?? this.gait;
    this.lastTickMs = this.pressedMs = performance.now();
    this.timer ??= setInterval(() => this.#tick(), PERIOD_MS);
  }

  /** It is held now, or a little further. What is pushed while something else drives has to be pushed anew. @param {Control[]} pushed */
  #held(pushed) {
    if (!pushed.some(moves) || this.driving === pushed) return;
    if (this.driving) {
      for (const each of pushed) each.release();
      this.callbacks.say(() => (this.driving ? "Something else drives already: let that go first, and push this anew." : ""));
      return;
    }
    this.driver = pushed;
    this.#press(false);
  }

  /** @param {number} byM */
  #rise(byM) {
    this.heightM = Math.round(((this.heightM ?? this.report?.height_m ?? USUAL_M) + byM) * 100) / 100;
    if (this.active) this.#press(false);
    this.refresh();
  }

  /** Something was pressed. @param {boolean} sits */
  #press(sits) {
    const nowMs = performance.now();
    if (!this.active) [this.lastTickMs, this.answerMs] = [nowMs, NaN];
    const why = obstacle(this, nowMs) || this.callbacks.busy();
    if (why) {
      this.#letGo();
      shake(LOST_MS);
      const of = cause(this, why);
      this.callbacks.say(() => `Nothing moves: ${of()}.`);
      return;
    }
    if (sits && !this.active) {
      this.callbacks.say("It sits already, as far as this page knows.");
      return;
    }
    this.press = this.link.nextId();
    this.goesOn = false;
    this.pressedMs = nowMs;
    if (this.dropped) this.callbacks.say("");
    this.dropped = false;
    this.sits = sits;
    if (!this.active) this.timer = setInterval(() => this.#tick(), PERIOD_MS);
    this.#send(nowMs);
    this.refresh();
  }

  #tick() {
    const nowMs = performance.now();
    const why = obstacle(this, nowMs);
    this.lastTickMs = nowMs;
    if (this.report === null && nowMs - this.pressedMs > BEGINS_MS) {
      this.end("the console has not confirmed the walk");
      return;
    }
    if (why) {
      this.drop(why); // nothing is sent, so the console makes the robot stand
      return;
    }
    for (const each of this.touch) each.check();
    this.#send(nowMs);
  }

  /** @param {number} sent_ms */
  #send(sent_ms) {
    const { x, y, turn } = this.deflection;
    const id = this.link.nextId();
    const part = PARTS[this.speed];
    const velocity = { forward_m_s: part * y * SPEED_M_S, left_m_s: part * -x * SPEED_M_S, turn_rad_s: part * -turn * TURN_RAD_S };
    const { press, gait, heightM: height_m, sits } = this;
    const sent = this.link.sendNow({ type: "walk", id, press, sent_ms, ...velocity, gait, height_m, sits });
    if (sent) this.sentMs.set(id, sent_ms);
  }

  #letGo() {
    for (const each of [...this.touch, ...this.keys, ...(this.driver ?? [])]) each.release();
    this.driver = null;
  }

  /** @param {"gait" | "speed"} name @returns {HTMLInputElement[]} */
  #choices(name) {
    return [...document.querySelectorAll(`input[name="${name}"]`)].map((each) => /** @type {HTMLInputElement} */ (each));
  }
}

/** @param {Deflection} deflection */
function moves({ x, y, turn }) {
  return x !== 0 || y !== 0 || turn !== 0;
}
