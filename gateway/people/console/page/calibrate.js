// @ts-check
/**
 * Calibration: the person starts one servo alone, jogs it and states what is seen; the console keeps the draft until it is
 * written.
 *
 * The servo under test runs only while this page is seen: this page alone sends its angle, 20 times a second, while there
 * is no obstacle (as for hold to run). Whatever ends that stops its leg.
 */

import { attribute, byId, confirmed, element, enable, show, text } from "./dom.js";
import { obstacle, PERIOD_MS, Starts, whenLost, whyNot } from "./hold.js";
import { JOINTS, LEGS } from "./kinematics.js";
import { ended } from "./words.js";

/** @typedef {import("./types.js").CalibrationMessage} CalibrationMessage */

/** This long after the last click or key the servo is stopped: the person may have left. */
const UNTOUCHED_MS = 120_000;
const STEPS = ["wrong_way", "lowest_here", "highest_here", "full_range", "as_drawn"];

export class Calibrate {
  /**
   * @param {import("./link.js").Link} link @param {import("./model.js").Model} model
   * @param {{mine: () => boolean, holds: () => boolean, say: (line: string) => void}} callbacks
   */
  constructor(link, model, callbacks) {
    this.link = link;
    this.model = model;
    this.callbacks = callbacks;
    /** The console's guide, as of its newest answer. @type {CalibrationMessage | null} */
    this.view = null;
    /** Requests that are not answered, by their numbers. @type {Map<number, string>} */
    this.asked = new Map();
    /** The servo under test. @type {number | null} */
    this.servo = null;
    this.starts = new Starts(([servo]) => this.#sendStop(servo));
    /** The set whose acknowledgement is awaited. @type {number | null} */
    this.setting = null;
    this.lastTickMs = 0;
    this.touchedMs = 0;
    /** Where each servo stood when its test ended: the next test suggests that angle. @type {Map<number, number>} */
    this.stood = new Map();
    /** @type {ReturnType<typeof setInterval> | undefined} */
    this.timer = undefined;
    this.cells = this.#table();
    for (const leg of LEGS) {
      for (const joint of JOINTS) {
        const servo = String(10 * leg + joint);
        byId("cal-servo").append(element("option", { value: servo }, `${servo}: leg ${leg}, joint ${joint}`));
      }
    }
    const details = byId("cal", HTMLDetailsElement);
    details.addEventListener("toggle", () => (details.open ? this.#ask("open") : this.stop("the calibration was closed")));
    for (const event of ["keydown", "pointerdown"]) window.addEventListener(event, () => (this.touchedMs = performance.now()), true);
    byId("cal-servo").addEventListener("change", () => this.#suggest());
    byId("cal-start").addEventListener("click", () => this.#start());
    byId("cal-stop").addEventListener("click", () => this.stop("stopped"));
    for (const [id, deg] of /** @type {[string, number][]} */ ([
      ["cal-down", -1],
      ["cal-down-fine", -0.1],
      ["cal-up-fine", 0.1],
      ["cal-up", 1],
    ])) {
      byId(id).addEventListener("click", () => this.#ask("jog", { deg }));
    }
    byId("cal-jog").addEventListener("keydown", (event) => this.#key(event));
    byId("cal-measured-form").addEventListener("submit", (event) => {
      event.preventDefault();
      const field = byId("cal-measured", HTMLInputElement);
      if (field.value !== "") this.#ask("stands_at", { deg: field.valueAsNumber });
      field.value = "";
    });
    for (const step of STEPS) byId(`cal-${step}`).addEventListener("click", () => this.#ask(step));
    byId("cal-undo").addEventListener("click", () => this.#ask("undo"));
    byId("cal-write").addEventListener("click", () => this.#write());
    byId("cal-landing").addEventListener("click", () => this.#landing());
    byId("cal-accept").addEventListener("click", () => this.#accept());
    whenLost(this, (why) => this.stop(why));
  }

  /** Whether a servo is under test: it runs, or is about to. */
  get active() {
    return this.servo !== null;
  }

  /** End the test: stop its leg, which the watchdog does if no Stop arrives. @param {string} why */
  stop(why) {
    const { servo } = this;
    if (servo === null) return;
    clearInterval(this.timer);
    this.timer = undefined;
    this.starts.abandon();
    this.servo = this.setting = null;
    if (this.view?.shown_deg != null) this.stood.set(servo, this.view.shown_deg);
    this.#suggest();
    const sent = this.#sendStop(servo);
    this.callbacks.say(`Servo ${servo}: ${why}.${sent ? "" : " Not connected: the watchdog stops it."}`);
    this.#ask("leave");
  }

  /** @param {CalibrationMessage} message */
  received(message) {
    const did = this.asked.get(message.id) ?? "";
    this.asked.delete(message.id);
    this.view = message;
    if (message.error) this.callbacks.say(`Calibration: ${message.error}.`);
    else if (message.note) this.callbacks.say(`Calibration: ${message.note}.`);
    if (did === "test" && !message.error) this.#energise();
    this.refresh();
  }

  /** @param {import("./types.js").AckMessage} message */
  receivedAck(message) {
    const said = whyNot(message);
    if (this.starts.answered(message) !== undefined) {
      if (said) this.stop(`it was not started (${said})`);
    } else if (message.id === this.setting) {
      this.setting = null;
      if (said) this.stop(said);
    }
  }

  /** The connection to the console ended, and with it the console's guide. @param {string} why */
  closed(why) {
    this.stop(why);
    this.asked.clear();
    this.view = null;
    const details = byId("cal", HTMLDetailsElement);
    details.open = false;
  }

  refresh() {
    const { view } = this;
    if (location.hash === "#cal" && this.link.open) {
      history.replaceState(null, "", location.pathname);
      if (byId("cal").getClientRects().length === 0) byId("more").click();
      const details = byId("cal", HTMLDetailsElement);
      details.open = true;
      details.scrollIntoView();
    }
    const mine = this.callbacks.mine();
    const tested = this.active;
    const fault = this.model.state?.calibration?.fault ?? null;
    show(byId("cal-untrusted"), fault !== null);
    text(byId("cal-fault"), fault ?? "");
    const { whole } = this.model;
    show(byId("cal-lease"), !mine);
    show(byId("cal-whole"), whole);
    text(byId("cal-revision"), view?.revision == null ? "" : `revision ${view.revision}`);
    show(byId("cal-choose"), !tested);
    show(byId("cal-test"), tested);
    enable(byId("cal-start", HTMLButtonElement), mine && !whole);
    enable(byId("cal-accept", HTMLButtonElement), mine);
    const changed = Object.values(view?.servos ?? {}).some((draft) => draft.changed);
    enable(byId("cal-write", HTMLButtonElement), mine && !tested && changed);
    enable(byId("cal-landing", HTMLButtonElement), mine);
    if (view?.servo != null && view.shown_deg != null && view.command_deg != null) {
      const apart = view.shown_deg === view.command_deg ? "" : `, ${degrees(view.command_deg)} by the calibration in force`;
      text(byId("cal-now"), `Servo ${view.servo} runs at ${degrees(view.shown_deg)}${apart}`);
    }
    for (const [servo, cell] of this.cells) {
      const draft = view?.servos[servo];
      text(cell, draft ? words(draft) : "");
      attribute(cell, "data-changed", draft?.changed ? "yes" : null);
    }
  }

  /** Suggest the angle at which the chosen servo begins: where its last test ended, else the nearest to its middle. */
  #suggest() {
    const servo = Number(byId("cal-servo", HTMLSelectElement).value);
    const draft = this.view?.servos[servo];
    const middle = draft ? Math.min(Math.max(90, draft.min_deg), draft.max_deg) : 90;
    byId("cal-begin", HTMLInputElement).value = String(this.stood.get(servo) ?? middle);
  }

  async #start() {
    const servo = Number(byId("cal-servo", HTMLSelectElement).value);
    const deg = byId("cal-begin", HTMLInputElement).valueAsNumber;
    if (!Number.isFinite(deg)) {
      this.callbacks.say("Calibration: type the angle at which it starts, such as 90.");
      return;
    }
    const agreed = await confirmed(
      `Start servo ${servo} at ${degrees(deg)}?`,
      "It goes there at once, as fast as it can, wherever it stands now. Keep hands and cables away.",
      `Start servo ${servo}`,
      "Leave it",
    );
    if (!agreed) return;
    if (this.callbacks.holds()) this.callbacks.say("Calibration: legs run; let go first.");
    else this.#ask("test", { servo, deg });
  }

  /** The console agreed to the angle: start it, alone. */
  #energise() {
    const servo = this.view?.servo;
    if (servo == null || this.servo !== null) return;
    this.lastTickMs = performance.now();
    const why = obstacle(this, this.lastTickMs);
    this.servo = servo;
    if (why) {
      this.stop(`it was not started (${why})`);
      return;
    }
    const id = this.link.nextId();
    this.starts.waiting.set(id, [servo]);
    if (!this.#command("start", id)) {
      this.stop(ended({ cause: "full" }).line);
      return;
    }
    this.timer = setInterval(() => this.#tick(), PERIOD_MS);
  }

  #tick() {
    const nowMs = performance.now();
    const hidden = byId("cal").getClientRects().length === 0 && "the calibration was closed"; // behind the pads, on a phone
    const untouched = nowMs - this.touchedMs > UNTOUCHED_MS && "nobody has touched this page for two minutes";
    const why = this.callbacks.holds() ? "legs are driven" : hidden || untouched || obstacle(this, nowMs);
    this.lastTickMs = nowMs;
    if (why) {
      this.stop(why);
      return;
    }
    if (this.starts.waiting.size) return;
    const id = this.setting === null ? (this.setting = this.link.nextId()) : undefined;
    this.#command("set", id);
  }

  /** @param {"start" | "set"} op @param {number} [id] @returns {boolean} */
  #command(op, id) {
    const payload = { op, angle_deg: this.view?.command_deg };
    const key = `hexapod/servo/${this.servo}/cmd`;
    return this.link.sendNow({ type: "command", key, payload, sent_ms: performance.now(), ...(id ? { id } : {}) });
  }

  /** @param {number} servo */
  #sendStop(servo) {
    const payload = { servos: [{ op: "stop" }, { op: "stop" }, { op: "stop" }] };
    const key = `hexapod/leg/${Math.floor(servo / 10)}/cmd`;
    return this.link.sendStop({ type: "command", key, payload, sent_ms: performance.now(), id: this.link.nextId() });
  }

  /** @param {KeyboardEvent} event */
  #key(event) {
    const step = { ArrowRight: 1, ArrowLeft: -1, ArrowUp: 0.1, ArrowDown: -0.1 }[event.key];
    if (step === undefined || event.target instanceof HTMLInputElement) return;
    event.preventDefault();
    if (![...this.asked.values()].includes("jog")) this.#ask("jog", { deg: step }); // so no step is left once the key is let go
  }

  async #write() {
    const changed = Object.entries(this.view?.servos ?? {}).filter(([, draft]) => draft.changed);
    const named = changed.map(([servo, draft]) => `${servo} (${words(draft)})`).join(", ");
    const question = "Write the calibration?";
    const agreed = await confirmed(question, `It is in force at once, for everybody: servo ${named}.`, "Write it", "Not yet");
    if (agreed) this.#ask("write");
  }

  async #landing() {
    const agreed = await confirmed(
      "Record the landing pose?",
      "The running servos' angles, as they are commanded now, become the pose in which the robot lands.",
      "Record it",
      "Leave it",
    );
    if (agreed) this.#ask("landing");
  }

  async #accept() {
    const agreed = await confirmed(
      "Go on without any trim?",
      "The file that cannot be used is replaced by the default: on a robot that is built otherwise, servos go where " +
        "nobody wants them.",
      "Take the default",
      "Leave it",
    );
    if (agreed) this.#ask("accept_default");
  }

  /** @param {string} step @param {object} [more] */
  #ask(step, more = {}) {
    const id = this.link.nextId();
    this.asked.set(id, step);
    if (this.link.sendNow({ type: "calibrate", id, do: step, ...more })) return;
    this.asked.delete(id);
    if (step !== "leave") this.callbacks.say("Not connected.");
  }

  #table() {
    /** @type {Map<number, HTMLElement>} */
    const cells = new Map();
    for (const leg of LEGS) {
      const row = element("tr", {}, element("th", { scope: "row" }, String(leg)));
      for (const joint of JOINTS) {
        const cell = element("td", {});
        cells.set(10 * leg + joint, cell);
        row.append(cell);
      }
      byId("cal-rows").append(row);
    }
    return cells;
  }
}

/** @param {number} deg */
function degrees(deg) {
  return `${Number(deg.toFixed(2))}°`;
}

/** @param {import("./types.js").Draft} draft */
function words(draft) {
  const trim = draft.trim_deg ? `${draft.trim_deg > 0 ? "+" : "−"}${Number(Math.abs(draft.trim_deg).toFixed(2))}°` : "";
  const limited = draft.min_deg !== 0 || draft.max_deg !== 180;
  const range = limited ? `${Number(draft.min_deg)}–${Number(draft.max_deg)}°` : "";
  const said = [trim, draft.inverted ? "inverted" : "", range].filter(Boolean).join(" ") || "as drawn";
  return draft.changed ? `* ${said}` : said;
}
