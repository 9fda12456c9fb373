// @ts-check
/**
 * This page is a stop button: a tap anywhere stops the robot, and so does this page's silence.
 *
 * It checks in by its own timer, and only while it is visible. A page that is hidden, or whose timer is late (frozen, or
 * throttled to once a second in the background), does not check in: that is a stop, and no flutter.
 */

import { attribute, byId, text } from "./dom.js";
import { Link } from "./link.js";
import { Awake, TAP_MS, fillScreen, shake } from "./phone.js";
import { stops } from "./stop.js";
import { because, ended, sentence } from "./words.js";

/** Check-ins within the time for which one counts. */
const SHARE = 4;
/** Of that time: the person is shown an answer that takes longer. */
const LATE = 0.25;
/** Of that time: a registration that takes longer does not count, since its delay is the measure of later ones. */
const REGISTERED_WITHIN = 0.5;
/** Times that time: then it registers anew, since the gateway allows a registration's clock little drift. */
const LIFE = 600;
const REFRESH_MS = 100;
const BUZZ_MS = [200, 100, 200];
const BUZZ_EVERY_MS = 1500;
/** If the console is silent for this long after a tap, the page connects again. */
const DEAF_MS = 1000;

/**
 * @typedef {{id: number, do: string, accepted: boolean | null, reason: string | null, detail: string | null,
 *            name: string | null, timeout_ms: number | null, alive: number | null, required: number | null}} Answer
 */

class StopButton {
  constructor() {
    this.link = new Link({ opened: () => this.#opened(), closed: (end) => this.#closed(end), received: (message) => this.#received(message) });
    this.watches = false;
    this.registered = false;
    this.timeoutMs = 1000;
    this.confirmedMs = -Infinity;
    /** When the registration has lived long enough. */
    this.endsMs = 0;
    /** How long the latest answer took. */
    this.answerMs = 0;
    /** What else the latest answer contains. */
    this.detail = "";
    this.lastTickMs = performance.now();
    this.trouble = "";
    this.name = "";
    this.count = "";
    /** The console lets this page only look. */
    this.looks = false;
    this.mode = "unknown";
    /** The console's sentence while the power board does not confirm a Stop. */
    this.unconfirmed = "";
    this.stopLine = "";
    /** @type {{id: number, atMs: number} | null} not confirmed yet */
    this.stopping = null;
    this.stoppedAtMs = Infinity;
    /** @type {{id: number, sentMs: number} | null} what is under way */
    this.asked = null;
    this.buzzedMs = -Infinity;
    this.awake = new Awake();
    /** @type {ReturnType<typeof setTimeout> | undefined} */
    this.timer = undefined;
    // A stop comes with the touch; what begins comes with its end, which alone lets a page have the full screen.
    byId("button").addEventListener("pointerdown", (event) => this.watches && this.#stop(event));
    byId("button").addEventListener("click", (event) => {
      if (!this.watches) this.#begin();
      else if (event.detail === 0) this.#stop(event); // of a keyboard
    });
    window.addEventListener("keydown", (event) => this.watches && stops(event) && !event.repeat && this.#stop(event), { capture: true });
    window.addEventListener("contextmenu", (event) => event.preventDefault());
    window.addEventListener("pagehide", () => this.#leave());
    byId("leave").addEventListener("click", () => this.#leave());
    setInterval(() => this.#refresh(), REFRESH_MS);
    this.#tick();
  }

  /** Whether the gateway counts this button, by its answers. */
  get counts() {
    return this.registered && performance.now() - this.confirmedMs < this.timeoutMs;
  }

  #begin() {
    if (this.looks) return;
    this.watches = true;
    fillScreen();
    this.awake.want(true);
    this.#register();
    this.#refresh();
  }

  /** @param {Event} event */
  #stop(event) {
    event.preventDefault();
    shake(TAP_MS);
    this.stopping ??= { id: this.link.nextId(), atMs: performance.now() };
    this.stopLine = "STOPPING …";
    this.stoppedAtMs = Infinity;
    this.#press(this.stopping.id);
    this.#refresh();
  }

  /** By this button's name. @param {number} id */
  #press(id) {
    this.link.sendStop({ type: "stop_all", id, button: true });
  }

  #register() {
    this.registered = false;
    this.#ask("register");
  }

  /** @param {string} verb */
  #ask(verb) {
    const now = performance.now();
    if (this.asked && now - this.asked.sentMs < this.timeoutMs) return;
    const asked = { id: this.link.nextId(), sentMs: now };
    this.asked = this.link.sendNow({ type: "button", id: asked.id, do: verb, sent_ms: now }) ? asked : null;
  }

  #tick() {
    const now = performance.now();
    const inTime = now - this.lastTickMs < this.timeoutMs / 2;
    this.lastTickMs = now;
    if (this.watches && inTime && document.visibilityState === "visible") {
      this.#ask(this.registered && now < this.endsMs ? "alive" : "register");
    }
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.#tick(), this.timeoutMs / SHARE);
  }

  #opened() {
    this.asked = null;
    if (this.stopping) this.#press(this.stopping.id);
    if (this.watches) this.#register(); // the token belongs to the connection before
  }

  /** @param {import("./words.js").End} end */
  #closed(end) {
    this.registered = false;
    this.asked = null;
    const { line, next } = ended(end);
    this.trouble = `${sentence(line)} ${next}`;
  }

  /** @param {any} message of the console */
  #received(message) {
    if (message.type === "hello") this.looks = message.role === "observer";
    else if (message.type === "state") {
      this.mode = message.state.mode;
      this.unconfirmed = message.unconfirmed ?? "";
      const newer = performance.now() - message.age_ms > this.stoppedAtMs;
      if (this.mode !== "estopped" && newer) this.stopLine = ""; // it was reset
    } else if (message.type === "stop" && message.id === this.stopping?.id) {
      if (message.answered) {
        this.stopping = null;
        this.stoppedAtMs = performance.now();
      }
      this.stopLine = message.answered ? `${message.stop_frames} Stops written${message.power ?? ""}` : `NOT STOPPED: ${message.error ?? "no answer yet"}`;
    } else if (message.type === "button") this.#answered(message);
    this.#refresh();
  }

  /** @param {Answer} answer */
  #answered(answer) {
    const asked = this.asked;
    if (!asked || answer.id !== asked.id) return;
    this.asked = null;
    this.answerMs = performance.now() - asked.sentMs;
    this.detail = (answer.accepted && answer.detail) || "";
    if (answer.accepted) {
      this.trouble = "";
      this.name = answer.name ?? this.name;
      this.timeoutMs = answer.timeout_ms ?? this.timeoutMs;
      this.count = answer.required ? `${answer.alive} of ${answer.required} alive` : `${answer.alive} alive, none required`;
      if (answer.do !== "register") this.confirmedMs = asked.sentMs;
      else if (this.answerMs < REGISTERED_WITHIN * this.timeoutMs) {
        this.registered = true;
        this.endsMs = asked.sentMs + LIFE * this.timeoutMs;
        this.#ask("alive");
      } else this.trouble = `to register took ${(this.answerMs / 1000).toFixed(1)} s, which is too long`;
      return;
    }
    this.trouble = sentence(because(answer) || "no answer");
    this.endsMs = Math.max(this.endsMs, performance.now() + (LIFE / 10) * this.timeoutMs); // the older one goes on
    // The gateway was started anew, or this device has slept: its clock stood still meanwhile.
    if (answer.accepted === false && (answer.reason === "unknown_button" || answer.reason === "stale")) this.registered = false;
  }

  #leave() {
    if (this.watches) this.link.sendNow({ type: "button", id: this.link.nextId(), do: "leave", sent_ms: performance.now() });
    this.watches = this.registered = false;
    this.awake.want(false);
  }

  /** What a person should know while this button counts. */
  #hint() {
    if (this.answerMs > LATE * this.timeoutMs) return `its answers come late: after ${(this.answerMs / 1000).toFixed(1)} s`;
    if (this.detail || this.awake.on) return this.detail;
    return "this screen may go dark by itself, which is a stop: let it stay on in the phone's settings";
  }

  #refresh() {
    const { counts } = this;
    const tone = !this.watches ? "off" : !counts ? "unheard" : this.unconfirmed ? "unconfirmed" : this.mode === "estopped" ? "stopped" : "watches";
    attribute(document.body, "data-tone", tone);
    const words = { off: this.looks ? "NO BUTTON" : "TAP TO WATCH", unheard: "NO SIGNAL", unconfirmed: "CUT POWER", stopped: "STOPPED", watches: "STOP" };
    text(byId("word"), words[tone]);
    const lines = {
      off: this.looks ? "this page may only look" : "then a tap anywhere stops the robot",
      unheard: `the gateway receives nothing from this button: use the switch. ${this.trouble}`,
      unconfirmed: this.unconfirmed,
      stopped: "",
      watches: this.#hint(),
    };
    text(byId("known"), tone === "unconfirmed" ? this.unconfirmed : this.stopLine || lines[tone]);
    text(byId("count"), this.watches ? `${this.name} · ${this.count}` : "");
    const now = performance.now();
    if (this.stopping && now - this.stopping.atMs > DEAF_MS) this.link.renewIfDeaf(DEAF_MS);
    if ((tone === "unheard" || tone === "unconfirmed") && now - this.buzzedMs > BUZZ_EVERY_MS) {
      this.buzzedMs = now;
      shake(BUZZ_MS);
    }
  }
}

new StopButton();
