// @ts-check
/** A link for another device, which works once, as a QR code. */

import { byId, show, text } from "./dom.js";
import { LOOPBACK } from "./words.js";

const SVG = "http://www.w3.org/2000/svg";
/** Light modules around the code, which a camera needs. */
const QUIET = 4;

export class Device {
  /** @param {import("./link.js").Link} link @param {(line: string) => void} say */
  constructor(link, say) {
    this.link = link;
    this.say = say;
    this.asked = 0;
    const details = byId("device", HTMLDetailsElement);
    details.addEventListener("toggle", () => (details.open ? this.#ask() : this.#forget()));
    byId("device-again").addEventListener("click", () => this.#ask());
    show(byId("device-loopback"), LOOPBACK.test(location.hostname));
  }

  /** @param {{id: number, url: string | null, rows: string[], error: string | null}} message */
  received(message) {
    if (message.id !== this.asked) return;
    if (message.url) byId("device-code").replaceChildren(picture(message.rows));
    text(byId("device-link"), message.url ?? message.error ?? "");
  }

  #ask() {
    this.#forget();
    this.asked = this.link.nextId();
    if (!this.link.sendNow({ type: "link_for", id: this.asked })) this.say("No link: not connected.");
  }

  /** Show no link to people who come later. */
  #forget() {
    this.asked = 0;
    byId("device-code").replaceChildren();
    text(byId("device-link"), "");
  }
}

/** @param {string[]} rows */
function picture(rows) {
  const size = rows.length + 2 * QUIET;
  const svg = document.createElementNS(SVG, "svg");
  svg.setAttribute("viewBox", `0 0 ${size} ${size}`);
  svg.setAttribute("role", "img");
  svg.setAttribute("aria-label", "QR code of the link below");
  const path = document.createElementNS(SVG, "path");
  const dark = rows.flatMap((row, y) => [...row].map((module, x) => (module === "1" ? `M${x + QUIET} ${y + QUIET}h1v1h-1z` : "")));
  path.setAttribute("d", dark.join(""));
  svg.append(path);
  return svg;
}
