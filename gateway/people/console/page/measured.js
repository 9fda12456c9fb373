// @ts-check
/** What the robot measures, in a strip over the picture: battery, tilt, temperature, power; what a walk by sensors feels; and which feet carry. */

import { attribute, byId, show, text } from "./dom.js";

/** @typedef {import("./types.js").Telemetry} Telemetry */

/** Below it a battery is low, in percent as the robot states it. */
const LOW_PERCENT = 20;
/** A foot carries with more than this part of what each of six equal ones would. */
const PART = 0.25;
/** How far the horizon moves for each degree that the front is higher or lower, in parts of its height. */
const RISE = 1 / 60;
const DEGREES = 180 / Math.PI;

/**
 * Which feet carry. The robot's unit of force is not known, so the six are compared with each other, and their sum with
 * the greatest before: the feet of a lifted robot carry nothing.
 */
export class Feet {
  constructor() {
    this.most = 0;
  }

  /** @param {(number | null)[]} forces of legs 1 to 6 @returns {boolean[]} */
  carry(forces) {
    const known = forces.map((force) => Math.max(0, force ?? 0));
    const sum = known.reduce((all, each) => all + each, 0);
    this.most = Math.max(this.most, sum);
    return known.map((force) => sum > PART * this.most && force > (PART * sum) / known.length);
  }
}

/**
 * The horizon as seen from behind, in degrees: how far it is turned to the right, and raised.
 * @param {number[]} orientation w, x, y, z @returns {{turned: number, raised: number} | null} null: it is no orientation
 */
export function horizon(orientation) {
  const length = Math.hypot(...orientation);
  if (!(length > 0)) return null;
  const [w, x, y, z] = orientation.map((each) => each / length);
  const [ahead, left, up] = [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]; // the world's up, on the body
  return { turned: -Math.atan2(left, up) * DEGREES, raised: -Math.asin(Math.max(-1, Math.min(1, ahead))) * DEGREES };
}

export class Measured {
  /** @param {import("./model.js").Model} model */
  constructor(model) {
    this.model = model;
    this.line = byId("horizon-line");
  }

  /** @param {number} nowMs @param {string} ground what this page's walk feels */
  refresh(nowMs, ground) {
    const { state } = this.model;
    const telemetry = this.model.measured(nowMs);
    const alive = state?.controller?.alive ?? null;
    const battery = telemetry?.battery ?? state?.battery ?? null;
    const tilt = telemetry?.tilt_deg ?? null;
    const temperature = telemetry?.temperature_c ?? null;
    const { power, unconfirmed } = this.model;
    show(byId("measured"), this.model.live(nowMs) && (power !== "" || alive === false || battery !== null || tilt !== null || temperature !== null));
    show(byId("controller-silent"), alive === false);
    show(byId("battery"), battery !== null);
    if (battery) {
      const { percent } = battery;
      const low = percent !== null && percent < LOW_PERCENT;
      attribute(byId("battery"), "data-low", low ? "yes" : "no");
      text(byId("volts"), `${battery.voltage_v.toFixed(1)} V${this.model.runs ? " under load" : ""}${percent === null ? "" : ", "}`);
      text(byId("battery-known"), percent === null ? "" : `${Math.round(percent)} %${low ? ", low" : ""}`);
    }
    show(byId("tilt"), tilt !== null);
    if (tilt !== null) text(byId("tilt-known"), `${Math.round(tilt)}°`);
    const seen = telemetry?.imu ? horizon(telemetry.imu.orientation_wxyz) : null;
    show(byId("horizon"), seen !== null);
    if (seen) this.line.style.transform = `rotate(${seen.turned.toFixed(0)}deg) translateY(${(-100 * RISE * seen.raised).toFixed(0)}%)`;
    show(byId("power"), power !== "");
    attribute(byId("power"), "data-bad", unconfirmed ? "yes" : "no");
    text(byId("power-known"), power);
    text(byId("supply"), telemetry?.supply ? `, ${telemetry.supply.voltage_v.toFixed(1)} V` : "");
    show(byId("temperature"), temperature !== null);
    if (temperature !== null) text(byId("temperature"), `${Math.round(temperature)} °C`);
    show(byId("ground"), this.model.live(nowMs) && ground !== "");
    text(byId("ground"), ground);
  }
}
