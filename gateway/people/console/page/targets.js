// @ts-check
/** Each servo's target: set by sliders, fields, poses and the gamepad, and sent while something is held. */

import { LEGS, NEUTRAL_DEG } from "./kinematics.js";

const SERVOS = LEGS.flatMap((leg) => [leg * 10 + 1, leg * 10 + 2, leg * 10 + 3]);
const STORE = "hexapod-console-poses";
const MOST_POSES = 100;

/** Degrees that the gateway accepts. @param {number} deg */
export function clamped(deg) {
  return Math.round(Math.min(180, Math.max(0, deg)) * 100) / 100;
}

export class Targets extends EventTarget {
  constructor() {
    super();
    /** @type {Map<number, number>} */
    this.degrees = new Map(SERVOS.map((servo) => [servo, NEUTRAL_DEG]));
    /** Servos that were set here; others follow what was commanded. @type {Set<number>} */
    this.own = new Set();
    /** What was sent last, on the way to the targets. @type {Map<number, number>} */
    this.sent = new Map();
  }

  /**
   * What to send next: the target, or at most `mostDeg` nearer to it than where the servo is commanded to.
   * @param {number} servo @param {number} mostDeg @param {number | undefined} commanded undefined: unknown
   */
  approach(servo, mostDeg, commanded) {
    const target = this.get(servo);
    const from = this.sent.get(servo) ?? commanded ?? target;
    const next = clamped(from + Math.max(-mostDeg, Math.min(mostDeg, target - from)));
    this.sent.set(servo, next);
    return next;
  }

  /** Forget what was sent: others may move the servos meanwhile. */
  forget() {
    this.sent.clear();
  }

  /** @param {number} servo @returns {number} */
  get(servo) {
    return this.degrees.get(servo) ?? NEUTRAL_DEG;
  }

  /** @param {number} servo @param {number} deg */
  set(servo, deg) {
    if (!Number.isFinite(deg)) return;
    this.own.add(servo);
    this.#put(servo, clamped(deg));
  }

  /** Take over what was commanded last. @param {Map<number, number>} commanded @param {boolean} all also what was set here */
  follow(commanded, all) {
    if (all) this.own.clear();
    for (const [servo, deg] of commanded) if (!this.own.has(servo)) this.#put(servo, deg);
  }

  /**
   * Begin from the pose of a robot that lies, and stay there but for what was set here: servos that start all together
   * must not lift it at once.
   * @param {[string, number][]} lying
   */
  lie(lying) {
    this.sent = new Map(lying.map(([servo, deg]) => [Number(servo), deg]));
    this.follow(this.sent, false);
  }

  /** @param {number} servo @param {number} deg */
  #put(servo, deg) {
    if (this.degrees.get(servo) === deg) return;
    this.degrees.set(servo, deg);
    this.dispatchEvent(new CustomEvent("change", { detail: servo }));
  }
}

/** Poses by name, in this browser only. */
export class Poses {
  /** @returns {Record<string, Record<string, number>>} */
  all() {
    try {
      const stored = JSON.parse(localStorage.getItem(STORE) ?? "{}");
      return stored && typeof stored === "object" ? stored : {};
    } catch {
      return {}; // another program's, or a browser that stores nothing
    }
  }

  /** @param {string} name @param {Targets} targets @returns {string} why it is not kept; "" if it is */
  keep(name, targets) {
    const poses = this.all();
    if (!(name in poses) && Object.keys(poses).length >= MOST_POSES) return "there are a hundred already";
    return this.#store({ ...poses, [name]: Object.fromEntries(targets.degrees) });
  }

  /** @param {string} name @param {Targets} targets */
  apply(name, targets) {
    const pose = this.all()[name] ?? {};
    for (const servo of SERVOS) if (typeof pose[servo] === "number") targets.set(servo, pose[servo]);
  }

  /** @param {string} name */
  remove(name) {
    const poses = this.all();
    delete poses[name];
    this.#store(poses);
  }

  /** @param {Record<string, Record<string, number>>} poses */
  #store(poses) {
    try {
      localStorage.setItem(STORE, JSON.stringify(poses));
      return "";
    } catch {
      return "this browser keeps nothing";
    }
  }
}
