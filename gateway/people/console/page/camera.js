// @ts-check
/**
 * A camera's picture, by a WebSocket of its own. The page asks for the next picture once it shows the newest. So one
 * picture at most is on its way, and the console knows what this page shows: by an old one it moves nothing.
 */

import { attribute, byId, show, text } from "./dom.js";
import { proved } from "./key.js";

const PATIENCE_MS = 5000;
const AGAIN_MS = 500;
const AGE_BYTES = 4;

export class Camera {
  /** @param {import("./link.js").Link} link @param {import("./model.js").Model} model @param {import("./words.js").Say} say */
  constructor(link, model, say) {
    this.link = link;
    this.model = model;
    /** The camera that is shown; "": none, or the window has no room. */
    this.name = "";
    this.view = 0;
    /** Numbers what is shown: a picture for an earlier number is late. */
    this.turn = 0;
    /** When the picture that is shown was taken, at the earliest. */
    this.takenMs = -Infinity;
    this.trouble = "";
    this.canvas = byId("camera", HTMLCanvasElement);
    byId("camera-next").addEventListener("click", () => {
      this.view += 1;
      this.#look();
      const { name, alone } = this.#wanted;
      say(name ? `The camera ${name}, ${alone ? "alone" : "with the robot"}.` : "No camera is shown, so the walk does not depend on one.");
    });
    show(byId("camera-next"), true);
  }

  /** The console has begun to serve this page. */
  begin() {
    this.name = "";
    this.#look();
  }

  /** Whether the picture that is shown is too old to drive by. @param {number} nowMs */
  old(nowMs) {
    const { stale_ms = 0 } = this.model.hello ?? {};
    return Boolean(this.name && stale_ms) && this.#ageMs(nowMs) >= stale_ms;
  }

  /** @param {number} nowMs */
  refresh(nowMs) {
    this.#look(); // the window may have another size
    const old = this.old(nowMs);
    const age = (this.#ageMs(nowMs) / 1000).toFixed(old ? 1 : 2);
    attribute(byId("picture"), "data-old", old ? "yes" : "no");
    show(byId("camera-age"), this.name !== "");
    text(byId("camera-age"), this.trouble || (this.takenMs === -Infinity ? "No picture yet" : old ? `The picture is ${age} s old` : `${age} s`));
  }

  /** What one tap after the other shows: each camera with the drawn robot, and alone; at last none. */
  get #wanted() {
    const { cameras = [] } = this.model.hello ?? {};
    const views = [...cameras.flatMap((name) => [false, true].map((alone) => ({ name, alone }))), { name: "", alone: false }];
    return views[this.view % views.length];
  }

  /** @param {number} nowMs */
  #ageMs(nowMs) {
    return nowMs + this.model.sleptMs - this.takenMs;
  }

  /** Show what is wanted, and report it to the console; a small window has no picture. */
  #look() {
    const { name, alone } = this.#wanted;
    show(this.canvas, name !== "");
    attribute(byId("picture"), "data-alone", alone ? "yes" : "no");
    attribute(byId("camera-next"), "aria-pressed", String(name !== ""));
    const seen = this.canvas.checkVisibility() ? name : "";
    if (seen === this.name || !this.link.sendNow({ type: "camera", shown: seen || null })) return;
    [this.name, this.takenMs, this.trouble] = [seen, -Infinity, ""];
    this.turn += 1;
    if (seen) void this.#follow(this.turn);
  }

  /** @param {number} turn */
  async #follow(turn) {
    while (this.turn === turn) {
      await this.#show(turn).catch(() => undefined); // its age shows that
      await new Promise((resolve) => setTimeout(resolve, AGAIN_MS));
    }
  }

  /** Show pictures until the connection ends, or this page is hidden. Throws Error. @param {number} turn */
  async #show(turn) {
    const address = new URL(`camera/${this.name}`, location.href);
    address.protocol = location.protocol === "https:" ? "wss:" : "ws:";
    address.search = new URLSearchParams({ page: String(this.model.hello?.page), ...(await proved(PATIENCE_MS)) }).toString();
    const socket = new WebSocket(address);
    socket.binaryType = "arraybuffer";
    try {
      await next(socket, "onopen");
      while (this.turn === turn && document.visibilityState === "visible") {
        const askedMs = performance.now() + this.model.sleptMs;
        socket.send("next");
        let { data } = await next(socket, "onmessage");
        for (; typeof data === "string"; data = (await next(socket, "onmessage")).data) this.trouble = data;
        const picture = await createImageBitmap(new Blob([data.slice(AGE_BYTES)], { type: "image/jpeg" }));
        if (this.turn !== turn) return;
        const { width, height } = picture;
        if (this.canvas.width !== width || this.canvas.height !== height) Object.assign(this.canvas, { width, height });
        this.canvas.getContext("2d")?.drawImage(picture, 0, 0);
        picture.close();
        // The picture may have been on its way since it was asked for.
        [this.takenMs, this.trouble] = [askedMs - new DataView(data).getFloat32(0, true), ""];
      }
    } finally {
      socket.close();
    }
  }
}

/**
 * Wait for the connection, or for its next message. Throws Error if it ends first.
 * @param {WebSocket} socket @param {"onopen" | "onmessage"} what @returns {Promise<any>}
 */
function next(socket, what) {
  return new Promise((resolve, reject) => {
    socket[what] = resolve;
    socket.onclose = () => reject(new Error("the camera's connection has ended"));
  });
}
