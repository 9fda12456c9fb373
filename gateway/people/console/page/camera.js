// @ts-check
/**
 * A camera's picture. The page asks for the next one once it shows the newest, whose number it states. So one picture at
 * most is on its way, and the console knows what this page shows: by an old one it moves nothing.
 */

import { attribute, byId, show, text } from "./dom.js";

const PATIENCE_MS = 10_000;
const AGAIN_MS = 250;

export class Camera {
  /** @param {import("./link.js").Link} link @param {import("./model.js").Model} model @param {import("./words.js").Say} say */
  constructor(link, model, say) {
    this.link = link;
    this.model = model;
    /** The camera that is shown; "": none, or the window has no room. */
    this.name = "";
    this.view = 0;
    /** When the picture that is shown was taken, at the earliest. */
    this.takenMs = -Infinity;
    /** Whether the picture that is shown is too old to drive by. */
    this.old = false;
    this.trouble = "";
    this.canvas = byId("camera", HTMLCanvasElement);
    byId("camera-next").addEventListener("click", () => {
      this.view += 1;
      this.#look();
      const { name, alone } = this.#wanted;
      say(name ? `The camera ${name}, ${alone ? "alone" : "with the robot"}.` : "No camera is shown, so the walk does not depend on one.");
    });
    show(byId("camera-next"), true);
    void this.#follow();
  }

  /** The console has begun to serve this page. */
  begin() {
    this.name = "";
    this.#look();
  }

  /** @param {number} nowMs */
  refresh(nowMs) {
    this.#look(); // the window may have another size
    const { stale_ms = 0 } = this.model.hello ?? {};
    const ageMs = nowMs + this.model.sleptMs - this.takenMs;
    this.old = this.name !== "" && stale_ms > 0 && ageMs >= stale_ms;
    const age = (ageMs / 1000).toFixed(this.old ? 1 : 2);
    attribute(byId("picture"), "data-old", this.old ? "yes" : "no");
    show(byId("camera-age"), this.name !== "");
    text(byId("camera-age"), this.trouble || (this.takenMs === -Infinity ? "No picture yet" : this.old ? `The picture is ${age} s old` : `${age} s`));
  }

  /** What one tap after the other shows: each camera with the drawn robot, and alone; at last none. */
  get #wanted() {
    const { cameras = [] } = this.model.hello ?? {};
    const views = [...cameras.flatMap((name) => [false, true].map((alone) => ({ name, alone }))), { name: "", alone: false }];
    return views[this.view % views.length];
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
  }

  async #follow() {
    for (let number = ""; ; ) {
      number = await this.#show(number).catch(() => ""); // its age shows that
      if (!number) await new Promise((resolve) => setTimeout(resolve, AGAIN_MS));
    }
  }

  /** Show a newer picture than that of number `shown`. Return its number; "": there is none. Throws Error. @param {string} shown */
  async #show(shown) {
    const { name } = this;
    if (!name || !this.link.open || document.visibilityState !== "visible") return "";
    const askedMs = performance.now() + this.model.sleptMs;
    const query = new URLSearchParams({ page: this.model.hello?.page ?? "", shown });
    const answer = await fetch(`camera/${name}?${query}`, { cache: "no-store", signal: AbortSignal.timeout(PATIENCE_MS) });
    if (answer.status === 202) this.trouble = await answer.text();
    if (answer.status !== 200) return "";
    const picture = await createImageBitmap(await answer.blob());
    if (this.name !== name) return "";
    const { width, height } = picture;
    if (this.canvas.width !== width || this.canvas.height !== height) Object.assign(this.canvas, { width, height });
    this.canvas.getContext("2d")?.drawImage(picture, 0, 0);
    picture.close();
    [this.takenMs, this.trouble] = [askedMs + Number(answer.headers.get("x-taken-ms")), ""];
    return answer.headers.get("x-picture") ?? "";
  }
}
