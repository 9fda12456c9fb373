// @ts-check
/** The lease: this page acquires it, asks for it, takes it after a question, hands it over, and releases it. */

import { attribute, byId, confirmed, enable, show, text } from "./dom.js";
import { UNDRIVEN, because, ended, sentence, short, undriven } from "./words.js";

/** @typedef {import("./types.js").LeaseMessage} LeaseMessage */

const RENEWALS_PER_TTL = 3;
const USUAL_TTL_MS = 1000;
/** Letters on a button, which must not grow; the line of what happened has the whole name. */
const LONGEST_NAME = 14;
const HANDED = "The lease is handed over to you: press Drive.";
const FREE = "The lease is free: press Drive.";
const GOT = "You drive: this page has the lease.";
/** This long after a lease was lost, a restart of the gateway is still its cause. */
const RESTART_MS = 30_000;

export class Lease {
  /**
   * @param {import("./link.js").Link} link @param {import("./model.js").Model} model
   * @param {{say: import("./words.js").Say, lost: (why: string, toDrive: () => string) => void, got: () => void}} callbacks
   */
  constructor(link, model, callbacks) {
    this.link = link;
    this.model = model;
    this.callbacks = callbacks;
    this.mine = false;
    /** @type {Map<number, string>} requests that are not answered, by their numbers */
    this.asked = new Map();
    /** @type {ReturnType<typeof setInterval> | undefined} */
    this.renewing = undefined;
    this.announced = "";
    this.lostMs = -Infinity;
    /** Whether this page has asked the holder for it, and may still get it. */
    this.wanted = false;
    byId("lease-acquire").addEventListener("click", () => this.#ask("acquire"));
    byId("lease-ask").addEventListener("click", () => this.#ask("ask"));
    byId("lease-take").addEventListener("click", () => this.#take());
    byId("lease-release").addEventListener("click", () => this.#ask("release"));
    byId("lease-hand-over").addEventListener("click", () => this.#ask("release", this.asker));
  }

  get holder() {
    return this.model.state?.lease?.holder ?? null;
  }

  get asker() {
    const by = this.model.state?.lease?.asked_by ?? null;
    return by === this.model.hello?.source ? null : by; // it has the lease meanwhile, and the state is older
  }

  /** @param {LeaseMessage} message */
  received(message) {
    const did = message.id == null ? "" : (this.asked.get(message.id) ?? "");
    if (message.id != null) this.asked.delete(message.id);
    const had = this.mine;
    this.mine = message.mine;
    if (message.mine && !had) {
      this.#renewEvery((message.ttl_ms ?? USUAL_TTL_MS) / RENEWALS_PER_TTL);
      this.callbacks.got();
      const got = this.wanted && did !== "take" ? "You drive: the lease was handed over to you. Press to move." : GOT;
      this.callbacks.say(() => (this.mine && this.model.live(performance.now()) ? got : ""));
      this.wanted = false;
    } else if (!message.mine && had) {
      const { end: cause, holder: by, silent_s } = message;
      this.#lost(cause ? ended({ cause, by, forMs: 1000 * (silent_s ?? 0) }).line : "");
    } else if (message.accepted !== true && did && did !== "renew") {
      const { holder } = this;
      this.callbacks.say(() => (this.holder === holder && !this.mine ? `No lease: ${because(message)}.` : ""));
    } else if (message.accepted && did === "ask") {
      this.wanted = true;
      this.callbacks.say(`Asked ${this.holder ?? "the driver"} for the lease.`);
    }
    this.refresh(performance.now());
  }

  /** The connection ended, and with it the lease. @param {string} line */
  closed(line) {
    this.asked.clear();
    this.wanted = false;
    if (this.mine) this.#lost(line);
  }

  /** The gateway was started again, and no longer knows any lease. */
  restarted() {
    const { line } = ended({ cause: "restarted" });
    if (this.mine || performance.now() - this.lostMs < RESTART_MS) this.#lost(line);
    else this.callbacks.say(() => sentence(line));
  }

  /** @param {number} nowMs */
  refresh(nowMs) {
    const { holder, asker, mine } = this;
    const looks = this.model.looks;
    const connected = this.model.live(nowMs);
    const unverified = holder && this.model.state?.lease?.verified === false ? ", not verified" : "";
    const others = holder ? `${holder}${unverified}` : undriven(this.model.state?.legs ?? [], (source) => this.model.who(source));
    const driver = !connected ? "unknown" : mine ? "you" : others;
    const said = byId("driver").textContent;
    text(byId("driver"), driver);
    if (driver.includes(UNDRIVEN) && driver !== said) this.callbacks.say(() => (byId("driver").textContent === driver ? sentence(driver) : ""));
    attribute(byId("driver"), "title", driver);
    const handed = !mine && this.model.handed;
    for (const id of ["lease-ask", "lease-take"]) show(byId(id), !mine && holder !== null && !looks && !handed);
    show(byId("lease-release"), mine);
    show(byId("lease-hand-over"), mine && asker !== null);
    text(byId("lease-hand-over"), `Hand over to ${short(asker ?? "", LONGEST_NAME)}`);
    for (const id of ["lease-acquire", "lease-ask", "lease-take"]) {
      enable(byId(id, HTMLButtonElement), connected);
    }
    show(byId("lease-acquire"), (!mine && holder === null && !looks) || handed);
    const taking = this.wanted && handed;
    // Nothing moves by it. A hidden page leaves the lease to others: a driver has to see the robot.
    if (taking && document.visibilityState === "visible" && ![...this.asked.values()].includes("acquire")) this.#ask("acquire");
    const over = (this.wanted && holder === null) || (this.announced === HANDED && !handed);
    if (over && !mine) this.callbacks.say(() => (this.mine || this.holder !== holder ? "" : holder === null ? FREE : `${holder} drives.`));
    if (over) this.wanted = false;
    this.announced = this.#announce(taking);
  }

  /** Announce who asks for the lease, or that it waits here. @param {boolean} taking @returns {string} what is to be said */
  #announce(taking) {
    const what = () => (this.mine && this.asker ? `${this.asker} asks for the lease.` : !this.mine && this.model.handed ? HANDED : "");
    const now = taking ? "" : what();
    if (now && now !== this.announced) this.callbacks.say(() => (what() === now ? now : ""));
    return now;
  }

  /** @param {string} line why; "": by this page's own wish */
  #lost(line) {
    clearInterval(this.renewing);
    this.mine = false;
    this.lostMs = performance.now();
    const to = { "press Drive": "Press Drive to go on.", "ask for it": "Ask for it to go on." };
    const toDrive = () => (line && !this.mine && this.model.live(performance.now()) ? ` ${to[this.model.toDrive]}` : "");
    this.callbacks.lost(`you do not drive any more${line ? `: ${line}` : ""}`, toDrive);
  }

  /** @param {number} everyMs */
  #renewEvery(everyMs) {
    clearInterval(this.renewing);
    this.renewing = setInterval(() => {
      // A hidden page does not renew: a driver has to see the robot.
      const waits = [...this.asked.values()].includes("renew");
      if (document.visibilityState === "visible" && !waits) this.#ask("renew");
    }, everyMs);
  }

  /** @param {"acquire" | "ask" | "take" | "renew" | "release"} verb @param {string | null} [to] */
  #ask(verb, to = null) {
    const id = this.link.nextId();
    this.asked.set(id, verb);
    const sent = this.link.sendNow({ type: "lease", id, do: verb, ...(to ? { to } : {}) });
    if (!sent && verb !== "renew") this.callbacks.say("Not connected.");
  }

  async #take() {
    const { holder } = this;
    if (holder === null) return;
    const agreed = await confirmed(
      `Take the lease from ${holder}?`,
      "All six legs stop first, and servos that stop hold no weight.",
      "Stop all legs and take it",
      "Leave it",
    );
    if (agreed) this.#ask("take");
  }
}
