// @ts-check
/** A robot that is simulated with physics: its pose in words, and the button that sets it upright. */

import { byId, show, text } from "./dom.js";
import { heightAbove, upAgainst } from "./terrain.js";

const SLOW = 0.95;

/**
 * Its pose, in one line.
 * @param {import("./types.js").Body} body
 */
export function inWords(body) {
  const up = upAgainst(body);
  const tilt = Math.round((Math.acos(Math.max(-1, Math.min(1, up))) * 180) / Math.PI);
  const how = body.upright ? `${Math.round(heightAbove(body) * 100)} cm high, leaning by ${tilt}°` : up < -0.5 ? "It lies on its back" : `It has fallen: it leans by ${tilt}°`;
  const slow = body.real_time_factor < SLOW ? `; this machine simulates ${body.real_time_factor.toFixed(2)} s of each second` : "";
  return `${how}${slow}.`;
}

export class Upright {
  /** @param {import("./link.js").Link} link @param {import("./model.js").Model} model @param {(line: string) => void} say */
  constructor(link, model, say) {
    this.model = model;
    this.say = say;
    /** @type {number | null} */
    this.askedId = null;
    byId("set-upright").addEventListener("click", () => {
      this.askedId = link.nextId();
      link.sendNow({ type: "upright", id: this.askedId });
    });
  }

  /** @param {import("./types.js").Body | null} body */
  refresh(body) {
    text(byId("see-title"), body ? "Where it is" : "As commanded");
    show(byId("sim-body"), body !== null);
    show(byId("see-hint"), body === null);
    show(byId("set-upright"), body !== null && !this.model.looks);
    if (body) text(byId("sim-known"), inWords(body));
  }

  /** @param {import("./types.js").AckMessage} message */
  receivedAck(message) {
    if (message.id !== this.askedId) return;
    this.askedId = null;
    this.say(message.ack?.accepted ? "It stands on its feet again." : `Not set upright: ${message.ack?.detail ?? message.error}`);
  }
}
