// @ts-check
/** The legs' table, the numbers and the events: text nodes that change only with their values. */

import { ago, attribute, byId, element, show, text } from "./dom.js";
import { LEGS } from "./kinematics.js";
import { reasonInWords, worded } from "./words.js";

/** @typedef {import("./model.js").Model} Model @typedef {import("./types.js").GatewayEvent} GatewayEvent
 * @typedef {import("./types.js").GatewayState} GatewayState */

const NAMES = {
  frames: "Frames a second",
  latency: "Stop latency p50 · p99 · max",
  lag: "Loop lag p50 · p99 · max",
  expirations: "Watchdog expirations",
  accepted: "Commands accepted",
  rejected: "Commands rejected",
  replaced: "Commands replaced",
  errors: "SPI errors",
  device: "Device",
  uptime: "Gateway up",
};
const MOST_REJECTORS = 5;
/** The bar of a servo that draws this is full, unless another draws more. */
const FULL_A = 1;

/** @typedef {{row: HTMLElement, status: HTMLElement, angles: HTMLElement[], draws: HTMLElement[], age: HTMLElement, bar: HTMLElement, by: HTMLElement}} Row */

export class Numbers {
  /** @param {Model} model @param {(leg: number) => void} select */
  constructor(model, select) {
    this.model = model;
    /** @type {Map<string, HTMLElement>} */
    this.values = new Map();
    for (const [key, name] of Object.entries(NAMES)) {
      const value = element("dd", { id: `number-${key}` }, "–");
      byId("numbers").append(element("div", {}, element("dt", {}, name), value));
      this.values.set(key, value);
    }
    this.rows = new Map(LEGS.map((leg) => [leg, this.#row(leg, select)]));
    /** Whether the newest state is the present. */
    this.live = false;
    /** @type {GatewayEvent | undefined} */
    this.newest = undefined;
  }

  /** @param {number} nowMs */
  refresh(nowMs) {
    const { model } = this;
    const { state } = model;
    const live = (this.live = model.live(nowMs));
    text(byId("mode"), state && live ? modeInWords(state.mode) : "unknown");
    attribute(byId("mode"), "data-mode", live ? (state?.mode ?? "unknown") : "unknown");
    const age = model.ageMs(nowMs);
    text(byId("age"), !state ? "none yet" : live ? `${Math.round(age / 10) * 10} ms old` : `the past: ${ago(age)} old`);
    attribute(byId("age"), "data-live", live ? "yes" : "no");
    this.#buttons(state?.buttons, live);
    text(byId("robot"), model.geometry?.name ?? "");
    if (!state) return;
    this.#currents(nowMs);
    for (const leg of state.legs) this.#leg(leg, state.watchdog.timeout_ms, nowMs, live);
    const rate = model.framesPerSecond();
    this.#set("frames", rate === null ? "–" : rate.toFixed(rate < 10 ? 1 : 0));
    this.#set("latency", latency(state.watchdog.stop_latency_us, "no Stop yet"));
    this.#set("lag", state.loop_lag_us ? latency(state.loop_lag_us, "none yet") : "unknown");
    this.#set("expirations", String(state.watchdog.expirations));
    this.#set("accepted", state.commands.accepted.toLocaleString("en"));
    this.#set("rejected", state.commands.rejected.toLocaleString("en"));
    this.#set("replaced", state.commands.coalesced.toLocaleString("en"));
    this.#set("errors", String(state.spi.errors));
    this.#set("device", state.simulated ? `simulated, ${state.spi.framing}` : `${state.spi.device}, ${state.spi.framing}`);
    this.#set("uptime", `${ago(state.uptime_s * 1000)}, version ${state.version}`);
  }

  /** Show the events again, if there is a new one. */
  refreshEvents() {
    const { model } = this;
    if (model.events[0] === this.newest) return;
    this.newest = model.events[0];
    byId("events").replaceChildren(...model.events.map((event) => eventLine(event, (said) => model.who(said))));
    const rejectors = [...model.rejections].sort((a, b) => b[1].count - a[1].count).slice(0, MOST_REJECTORS);
    if (!rejectors.length) return;
    byId("rejections").replaceChildren(
      ...rejectors.map(([source, { count, reason }]) => element("li", {}, `${source}: ${count} (last: ${reasonInWords(reason)})`)),
    );
  }

  /** @param {import("./types.js").Leg} leg @param {number} timeoutMs @param {number} nowMs @param {boolean} live */
  #leg(leg, timeoutMs, nowMs, live) {
    const row = this.rows.get(leg.leg);
    if (!row) return;
    const status = this.model.status(leg.leg, nowMs);
    text(row.status, `${status.mark} ${status.word}`);
    attribute(row.status, "data-status", status.key);
    attribute(row.row, "data-selected", this.model.selectedLeg === leg.leg ? "yes" : null);
    leg.servos.forEach((servo, index) => text(row.angles[index], servo.angle_deg === null || !live ? "–" : `${servo.angle_deg.toFixed(1)}°`));
    const age = leg.age_ms === null ? null : leg.age_ms + Math.max(0, this.model.ageMs(nowMs));
    const counted = age !== null && live && leg.watchdog === "armed";
    text(row.age, age === null ? "never" : counted ? `${Math.round(age / 10) * 10} of ${timeoutMs} ms` : `${ago(age)} ago`);
    row.bar.style.width = `${counted ? Math.min(100, (100 * age) / timeoutMs).toFixed(0) : 0}%`;
    const by = live ? this.#by(leg) : "–";
    text(row.by, by);
    attribute(row.by, "title", by);
  }

  /** Whose command the leg's last one was; the gateway itself may have stopped it since. @param {import("./types.js").Leg} leg */
  #by({ source, watchdog, age_ms }) {
    if (source !== null) return this.model.who(source);
    if (age_ms === null) return "–";
    return watchdog === "expired" ? "the watchdog" : this.model.state?.mode === "estopped" ? "STOP ALL" : "no name";
  }

  /** A bar for what each servo draws, and what draws most; nothing where nobody measures it. @param {number} nowMs */
  #currents(nowMs) {
    const servos = Object.entries(this.model.measured(nowMs)?.servos ?? {});
    const drawn = new Map(servos.flatMap(([id, { current_a }]) => (current_a === undefined ? [] : [[Number(id), current_a]])));
    const most = [...drawn].reduce((first, each) => (each[1] > first[1] ? each : first), [0, 0]);
    const sum = [...drawn.values()].reduce((all, each) => all + each, 0);
    for (const [leg, { draws }] of this.rows) {
      draws.forEach((bar, index) => {
        const current = drawn.get(10 * leg + index + 1);
        show(/** @type {HTMLElement} */ (bar.parentElement), current !== undefined);
        bar.style.width = `${Math.round((100 * (current ?? 0)) / Math.max(FULL_A, most[1]))}%`;
        attribute(bar, "title", current === undefined ? null : `${current.toFixed(2)} A`);
      });
    }
    show(byId("draws"), drawn.size > 0);
    text(byId("draws"), most[0] ? `Servo ${most[0]} draws most: ${most[1].toFixed(2)} A of ${sum.toFixed(2)} A. A full bar is ${Math.max(FULL_A, most[1]).toFixed(2)} A.` : "No servo draws anything.");
  }

  /** The stop buttons; nothing if none is required or alive. @param {GatewayState["buttons"]} buttons @param {boolean} live */
  #buttons(buttons, live) {
    const { alive, required, names } = buttons ?? { alive: 0, required: 0, names: [] };
    show(byId("buttons-fact"), alive + required > 0);
    text(byId("buttons"), !live ? "unknown" : required ? `${alive} of ${required} alive` : `${alive} alive`);
    attribute(byId("buttons"), "data-enough", live && alive >= required ? "yes" : "no");
    attribute(byId("buttons"), "title", names.join(", ") || null);
  }

  /** @param {string} key @param {string} value */
  #set(key, value) {
    const node = this.values.get(key);
    if (node) text(node, this.live ? value : "–");
  }

  /** @param {number} leg @param {(leg: number) => void} select @returns {Row} */
  #row(leg, select) {
    const status = element("td", { class: "status" }, "○ no state yet");
    const angles = [1, 2, 3].map(() => element("span", {}, "–"));
    const draws = [1, 2, 3].map(() => element("span", { class: "bar" }));
    const bar = element("span", { class: "bar" });
    const age = element("span", {}, "never");
    const by = element("td", { class: "by" }, "–");
    const row = element(
      "tr",
      { id: `leg-row-${leg}` },
      element("th", { scope: "row" }, String(leg)),
      status,
      ...angles.map((angle, index) => element("td", { class: "number" }, angle, element("span", { class: "track", hidden: "" }, draws[index]))),
      element("td", { class: "age" }, age, element("span", { class: "track", "aria-hidden": "true" }, bar)),
      by,
    );
    row.addEventListener("click", () => select(leg)); // the leg's own choice has a place of its own for keyboards
    byId("leg-rows").append(row);
    return { row, status, angles, draws, age, bar, by };
  }
}

/** @param {string} mode */
function modeInWords(mode) {
  return { estopped: "stopped, latched", bus_fault: "bus fault" }[mode] ?? mode;
}

/** @param {{p50: number | null, p99: number | null, max: number | null}} of in µs @param {string} none */
function latency({ p50, p99, max }, none) {
  if (p50 === null || p99 === null || max === null) return none;
  return [p50, p99, max].map((us) => (us / 1000).toFixed(1)).join(" · ") + " ms";
}

/** @param {GatewayEvent} event @param {(said: string) => string} who */
function eventLine(event, who) {
  const kind = event.kind.replace("estop", "stop_all").replaceAll("_", " ");
  const time = element("time", { datetime: event.time }, new Date(event.time).toLocaleTimeString("en-GB"));
  const source = event.source && !event.detail.includes(event.source) ? `${event.source}: ` : "";
  const more = event.left_out ? ` (and ${event.left_out} more)` : "";
  return element("li", { "data-tone": event.tone ?? "plain" }, time, element("b", {}, kind), element("span", {}, `${who(`${source}${worded(event.detail)}`)}${more}`));
}
