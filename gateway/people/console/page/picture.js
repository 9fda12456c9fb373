// @ts-check
/** The picture of what was commanded: in three dimensions, or from above where the browser has no WebGL. */

import { Above } from "./above.js";
import { course } from "./course.js";
import { attribute, byId, element, show, text } from "./dom.js";
import { LEGS, legPoints } from "./kinematics.js";
import { Odometry } from "./odometry.js";

/** A picture that takes longer delays the messages that are sent 20 times a second. */
const SLOW_MS = 60;
/** After this number of them in a row it is drawn from above. */
const MOST_SLOW = 2;

export class Picture {
  /** @param {import("./model.js").Model} model @param {(leg: number) => void} select @param {(line: string) => void} say @param {import("./upright.js").Upright} fallen */
  constructor(model, select, say, fallen) {
    this.model = model;
    this.fallen = fallen;
    this.say = say;
    this.odometry = new Odometry();
    this.slow = 0;
    this.place = byId("picture");
    /** @type {import("./scene.js").Scene | Above | null} */
    this.view = null;
    /** @type {import("./types.js").Geometry | null} */
    this.geometry = null;
    this.drawn = "";
    this.goes = false;
    this.labels = new Map(
      LEGS.map((leg) => {
        const label = element("button", { type: "button", class: "label" }, "", element("span", {}));
        label.addEventListener("click", () => select(leg));
        byId("labels").append(label);
        return [leg, label];
      }),
    );
    this.solid = byId("view-solid", HTMLInputElement);
    for (const id of ["view-solid", "view-above"]) byId(id).addEventListener("change", () => this.#build());
    this.solid.addEventListener("change", () => (this.insists = true));
    this.insists = false;
    this.place.addEventListener("turned", () => this.#draw());
    new ResizeObserver(() => this.#draw()).observe(this.place);
  }

  /** @param {number} nowMs @param {number[]} going forward and left in m/s, turn in rad/s */
  refresh(nowMs, going = [0, 0, 0]) {
    const { model } = this;
    if (!model.geometry) return;
    if (model.geometry !== this.geometry) {
      this.geometry = model.geometry;
      this.#build();
    }
    const live = model.live(nowMs);
    attribute(this.place, "data-live", live ? "yes" : "no");
    const body = model.body(nowMs);
    this.fallen.refresh(body);
    const poses = new Map(
      LEGS.map((number) => {
        const status = model.status(number, nowMs);
        const label = this.labels.get(number);
        if (label) {
          const [mark, word] = label.childNodes;
          text(mark, `${number} ${status.mark} `);
          text(word, status.word.split(" ")[0]);
          attribute(label, "data-status", status.key);
          attribute(label, "aria-pressed", String(model.selectedLeg === number));
        }
        const carries = model.carries(number, nowMs);
        return [number, { carries, degrees: model.degrees(number), trueDegrees: trueDegrees(body, number), status: status.key, selected: model.selectedLeg === number }];
      }),
    );
    const way = course(going);
    if (way.length && !this.goes) this.view?.chase();
    this.goes = way.length > 0;
    const now = JSON.stringify([[...poses], way, body?.position_m, body?.orientation_xyzw]);
    if (now === this.drawn || !this.view) return;
    this.drawn = now;
    if (body) this.odometry.see(body);
    else this.odometry.update(this.#feet(this.geometry));
    const beganMs = performance.now();
    this.view.update(poses, this.odometry, body, way);
    this.#describe(body !== null, nowMs);
    this.#draw();
    this.#judge(performance.now() - beganMs);
  }

  /** Of the legs that run. @param {import("./types.js").Geometry} geometry */
  #feet(geometry) {
    const running = (this.model.state?.legs ?? []).filter((leg) => leg.servos.every((servo) => servo.running));
    return new Map(running.map(({ leg }) => [leg, legPoints(geometry, leg, this.model.degrees(leg))[4]]));
  }

  /** Draw from above if drawing delays what is sent. @param {number} tookMs */
  #judge(tookMs) {
    this.slow = tookMs > SLOW_MS ? this.slow + 1 : 0;
    if (this.slow < MOST_SLOW || !this.solid.checked || this.insists) return;
    byId("view-above", HTMLInputElement).checked = true;
    this.say("3D is too slow in this browser, so the robot is drawn from above.");
    void this.#build();
  }

  #draw() {
    if (!this.view) return;
    this.view.draw();
    const width = this.place.clientWidth;
    const height = this.place.clientHeight;
    for (const [leg, label] of this.labels) {
      const [x, y] = this.view.labelAt(leg);
      const half = label.offsetWidth / 2 + 1;
      const left = Math.min(width - half, Math.max(half, x));
      const top = Math.min(height - 16, Math.max(16, y));
      label.style.transform = `translate(-50%, -50%) translate(${left.toFixed(0)}px, ${top.toFixed(0)}px)`;
    }
  }

  /** Describe it in words, for screen readers. @param {boolean} isThere not only commanded @param {number} nowMs */
  #describe(isThere, nowMs) {
    const foot = (/** @type {number} */ leg) => ({ true: " and carries", false: " and carries nothing", null: "" })[`${this.model.carries(leg, nowMs)}`];
    const words = LEGS.map((leg) => `leg ${leg} ${this.model.status(leg, nowMs).word}${foot(leg)}`).join(", ");
    if (this.view) attribute(this.view.canvas, "aria-label", `The robot ${isThere ? "where it is" : "as commanded"}: ${words}`);
  }

  async #build() {
    const { geometry } = this;
    if (!geometry) return;
    this.view?.dispose();
    this.view = null;
    this.slow = 0;
    this.drawn = "";
    if (this.solid.checked && !document.createElement("canvas").getContext("webgl2")) this.#cannot();
    if (this.solid.checked) {
      try {
        const { Scene } = await import("./scene.js");
        if (this.geometry !== geometry || this.view) return;
        this.view = new Scene(this.place, geometry, () => {
          this.#cannot();
          void this.#build();
        });
      } catch {
        this.#cannot();
      }
    }
    this.view ??= new Above(this.place, geometry);
    this.refresh(performance.now());
  }

  /** There is no WebGL, or it was lost. */
  #cannot() {
    this.solid.checked = false;
    this.solid.disabled = true;
    byId("view-above", HTMLInputElement).checked = true;
    show(byId("no-webgl"), true);
  }
}

/** Of a leg that is simulated with physics. @param {import("./types.js").Body | null} body @param {number} leg */
function trueDegrees(body, leg) {
  return body ? [1, 2, 3].map((joint) => body.servos[`${leg * 10 + joint}`].angle_deg) : null;
}
