// @ts-check
/** The controls of single legs: their choice, sliders and typed angles, hold to run, Stops, poses. */

import { attribute, byId, element, enable, show, text, typesText } from "./dom.js";
import { barred } from "./hold.js";
import { placeOf, whenReleased } from "./keys.js";
import { JOINTS, LEGS } from "./kinematics.js";
import { Poses } from "./targets.js";

/** @typedef {import("./model.js").Model} Model @typedef {import("./targets.js").Targets} Targets */

const HOLD_KEY = "KeyH";

export class Drive {
  /**
   * @param {Model} model @param {Targets} targets @param {import("./hold.js").Hold} hold
   * @param {{say: (line: string) => void, select: (leg: number) => void}} callbacks
   */
  constructor(model, targets, hold, callbacks) {
    this.model = model;
    this.targets = targets;
    this.hold = hold;
    this.callbacks = callbacks;
    this.poses = new Poses();
    /** @type {Set<number>} */
    this.chosen = new Set();
    this.choices = new Map(LEGS.map((leg) => [leg, this.#choice(leg)]));
    this.selectors = new Map(LEGS.map((leg) => [leg, this.#selector(leg)]));
    this.sliders = JOINTS.map((joint) => this.#slider(joint));
    targets.addEventListener("change", () => this.#showTargets());
    this.#holdButton("hold", "button");
    this.#holdButton("hold-leg", "leg");
    this.#keys();
    byId("stop-leg").addEventListener("click", () => this.#stop([model.selectedLeg]));
    byId("stop-legs").addEventListener("click", () => this.#stop(LEGS));
    byId("follow").addEventListener("click", () => targets.follow(model.lastDeg, true));
    byId("run-all").addEventListener("click", () => this.#choose(LEGS));
    byId("run-none").addEventListener("click", () => this.#choose([]));
    this.#poseForm();
    this.#showTargets();
  }

  /** The legs that a hold by this runs. @param {string} by @param {number} single the leg of a hold for one */
  legsOf(by, single) {
    if (this.model.whole) return LEGS;
    return by === "leg" || by === "gamepad" ? [single] : [...this.chosen];
  }

  /** Show another leg as selected. */
  selected() {
    const leg = this.model.selectedLeg;
    for (const [each, input] of this.selectors) input.checked = each === leg;
    text(byId("hold-leg-name"), String(leg));
    text(byId("stop-leg-name"), String(leg));
    this.#showTargets();
  }

  refresh(nowMs = performance.now()) {
    const looks = this.model.looks;
    const may = barred(this.hold, nowMs) === "";
    for (const id of ["hold", "hold-leg"]) attribute(byId(id), "aria-disabled", may ? "false" : "true"); // pressed, it shows why
    show(byId("controls"), !looks);
    show(byId("only-looks"), looks);
    const { whole } = this.model;
    show(byId("whole"), whole);
    show(byId("stop-leg-all"), whole);
    for (const id of ["hold-leg", "run-chooser", "run-all", "run-none"]) show(byId(id), !whole);
    const { active } = this.hold;
    attribute(byId("hold"), "data-held", active ? "yes" : "no");
    attribute(byId("hold-leg"), "data-held", active && this.hold.by === "leg" ? "yes" : "no");
    const leg = this.model.leg(this.model.selectedLeg);
    this.sliders.forEach((slider, index) => {
      const deg = leg?.servos[index].angle_deg ?? null;
      text(slider.now, !this.model.live(nowMs) ? "–" : deg === null ? "off" : `${deg.toFixed(1)}°`);
    });
    for (const [number, input] of this.choices) {
      const runs = this.hold.running.has(number);
      attribute(/** @type {HTMLElement} */ (input.parentElement), "data-runs", runs ? "yes" : null);
    }
  }

  /** @param {number[]} legs */
  #stop(legs) {
    const sent = this.hold.stop(legs);
    this.callbacks.say(sent ? `Stops sent to ${legs.length === 1 && !this.model.whole ? `leg ${legs[0]}` : "all six legs"}.` : "NOT CONNECTED: use the switch.");
  }

  /** @param {number[]} legs */
  #choose(legs) {
    for (const leg of LEGS) this.#tick(leg, legs.includes(leg));
  }

  /** @param {number} leg @param {boolean} chosen */
  #tick(leg, chosen) {
    const input = this.choices.get(leg);
    if (input) input.checked = chosen;
    if (chosen) this.chosen.add(leg);
    else this.chosen.delete(leg);
  }

  /** @param {number} leg */
  #choice(leg) {
    const input = element("input", { type: "checkbox", id: `run-${leg}` });
    input.addEventListener("change", () => (input.checked ? this.chosen.add(leg) : this.chosen.delete(leg)));
    input.addEventListener("keydown", (event) => {
      if (event.key === "Enter") input.click(); // space is STOP ALL
    });
    byId("run-chooser").append(element("label", {}, input, element("span", {}, String(leg))));
    return input;
  }

  /** @param {number} leg */
  #selector(leg) {
    const input = element("input", { type: "radio", name: "leg", id: `leg-${leg}`, value: String(leg) });
    input.addEventListener("change", () => this.callbacks.select(leg));
    byId("leg-chooser").append(element("label", {}, input, element("span", {}, String(leg))));
    return input;
  }

  /** @param {number} joint */
  #slider(joint) {
    const id = `joint-${joint}`;
    const name = `Joint ${joint}`;
    const range = element("input", { type: "range", id, min: "0", max: "180", step: "0.5" });
    const field = element("input", { type: "number", min: "0", max: "180", step: "any", inputmode: "decimal" });
    field.setAttribute("aria-label", `${name}, degrees, typed`);
    const now = element("span", { class: "now" });
    const set = (/** @type {string} */ value) => {
      if (value !== "") this.targets.set(this.model.selectedLeg * 10 + joint, Number(value));
    };
    range.addEventListener("input", () => set(range.value));
    field.addEventListener("change", () => set(field.value)); // not at each key: 1 and 12 are on the way to 120
    byId("sliders").append(element("div", { class: "slider" }, element("label", { for: id }, name), field, now, range));
    return { range, field, now };
  }

  #showTargets() {
    this.sliders.forEach(({ range, field }, index) => {
      const deg = String(this.targets.get(this.model.selectedLeg * 10 + JOINTS[index]));
      if (range.value !== deg) range.value = deg;
      if (field.value !== deg && field !== document.activeElement) field.value = deg;
    });
  }

  /** @param {string} id @param {string} what */
  #holdButton(id, what) {
    const button = byId(id);
    button.addEventListener("pointerdown", (event) => {
      if (event.button !== 0) return;
      button.setPointerCapture(event.pointerId);
      this.hold.press(what);
    });
    for (const name of ["pointerup", "pointercancel", "lostpointercapture"]) {
      button.addEventListener(name, () => this.hold.release(what));
    }
    button.addEventListener("contextmenu", (event) => event.preventDefault()); // a long touch
    button.addEventListener("keydown", (event) => {
      if (event.key !== "Enter") return;
      event.preventDefault();
      if (!event.repeat) this.hold.press(what);
    });
    for (const name of ["keyup", "blur"]) {
      button.addEventListener(name, (event) => {
        if (!(event instanceof KeyboardEvent) || event.key === "Enter") this.hold.release(what);
      });
    }
    whenReleased((place) => place === null && this.hold.release(what));
  }

  #keys() {
    window.addEventListener("keydown", (event) => {
      const modified = event.ctrlKey || event.altKey || event.metaKey;
      if (placeOf(event) !== HOLD_KEY || event.repeat || modified || typesText(event.target)) return;
      if (byId("question", HTMLDialogElement).open) return;
      this.hold.press("key");
    });
    whenReleased((place) => (place === null || place === HOLD_KEY) && this.hold.release("key"));
  }

  #poseForm() {
    const name = byId("pose-name", HTMLInputElement);
    const list = () => {
      const names = Object.keys(this.poses.all()).sort();
      byId("pose-names").replaceChildren(...names.map((each) => element("option", { value: each })));
      const known = names.includes(name.value.trim());
      enable(byId("pose-load", HTMLButtonElement), known);
      enable(byId("pose-remove", HTMLButtonElement), known);
    };
    name.addEventListener("input", list);
    byId("pose-form").addEventListener("submit", (event) => {
      event.preventDefault();
      if (!name.value.trim()) return;
      const why = this.poses.keep(name.value.trim(), this.targets);
      this.callbacks.say(why ? `The pose is not kept: ${why}.` : `Pose "${name.value.trim()}" is kept in this browser.`);
      list();
    });
    byId("pose-load").addEventListener("click", () => this.poses.apply(name.value.trim(), this.targets));
    byId("pose-remove").addEventListener("click", () => {
      this.poses.remove(name.value.trim());
      list();
    });
    list();
  }
}
