// @ts-check
/** The WebSocket to the console: receives and sends messages, and connects again whenever it ends. */

import { proved, tab } from "./key.js";

const FIRST_PAUSE_MS = 250;
const LONGEST_PAUSE_MS = 2000;
const ALIVE_EVERY_MS = 1000;
/** More unsent bytes than these show that the network is gone. */
const MOST_UNSENT_BYTES = 4096;
/** What the codes of a connection's end mean (RFC 6455); by others it was lost. @type {Record<number, import("./words.js").Cause>} */
const CODES = { 1001: "closed", 1008: "rejected", 1012: "closed", 1013: "rejected" };
const SIGNED_OUT = "signed out";
/** A connection that is silent for this long is closed: after a change of a phone's network it would stay open for minutes. */
const DEAF_MS = 5000;

export class Link {
  /**
   * @param {{
   *   opened: () => void,
   *   closed: (end: import("./words.js").End) => void,
   *   received: (message: any) => void,
   * }} callbacks
   */
  constructor(callbacks) {
    this.callbacks = callbacks;
    this.open = false;
    /** @type {WebSocket | null} */
    this.socket = null;
    this.pauseMs = FIRST_PAUSE_MS;
    this.lastId = 0;
    /** When the newest message was received, or a connection was begun. */
    this.receivedMs = performance.now();
    setInterval(() => {
      this.sendNow({ type: "alive", now_ms: performance.now() });
      this.renewIfDeaf(DEAF_MS);
    }, ALIVE_EVERY_MS);
    void this.#connect();
  }

  /** A new number, which the answer repeats. */
  nextId() {
    this.lastId += 1;
    return this.lastId;
  }

  /**
   * Send it now or never: nothing that moves a servo may wait until a network is back.
   * @param {object} message @returns {boolean} whether it is on its way
   */
  sendNow(message) {
    if (!this.open || !this.socket || this.socket.bufferedAmount > MOST_UNSENT_BYTES) return false;
    this.socket.send(JSON.stringify(message));
    return true;
  }

  /** Send a Stop, also if others wait to be sent: a late one does no harm. @param {object} message */
  sendStop(message) {
    if (!this.open || !this.socket) return false;
    this.socket.send(JSON.stringify(message));
    return true;
  }

  /** Connect again if the connection has been silent for this long. @param {number} ms */
  renewIfDeaf(ms) {
    const { socket } = this;
    if (!socket || performance.now() - this.receivedMs < ms) return;
    this.open = false;
    this.socket = null;
    socket.close(); // what it still sends is ignored
    this.callbacks.closed({ cause: "deaf" });
    void this.#connect();
  }

  async #connect() {
    this.receivedMs = performance.now();
    let shown;
    try {
      shown = await proved(DEAF_MS);
    } catch (error) {
      const { message, cause } = /** @type {Error} */ (error);
      this.callbacks.closed({ cause: /** @type {import("./words.js").Cause} */ (cause ?? "lost"), detail: message });
      this.#again();
      return;
    }
    this.receivedMs = performance.now();
    const address = new URL("ws", location.href);
    address.protocol = location.protocol === "https:" ? "wss:" : "ws:";
    address.search = new URLSearchParams({ tab: tab(), ...shown }).toString();
    const socket = new WebSocket(address);
    this.socket = socket;
    socket.addEventListener("open", () => {
      if (this.socket !== socket) return;
      this.open = true;
      this.pauseMs = FIRST_PAUSE_MS;
      this.sendNow({ type: "alive", now_ms: performance.now() });
      this.callbacks.opened();
    });
    socket.addEventListener("message", (event) => {
      if (this.socket !== socket) return;
      this.receivedMs = performance.now();
      this.callbacks.received(JSON.parse(event.data));
    });
    socket.addEventListener("close", (event) => {
      if (this.socket === socket) this.#ended(event);
    });
  }

  /** @param {CloseEvent} event */
  #ended(event) {
    this.open = false;
    this.socket = null;
    const cause = event.reason === SIGNED_OUT ? "signed_out" : (CODES[event.code] ?? (navigator.onLine ? "lost" : "offline"));
    this.callbacks.closed({ cause, detail: event.reason });
    this.#again();
  }

  #again() {
    setTimeout(() => void this.#connect(), this.pauseMs);
    this.pauseMs = Math.min(this.pauseMs * 2, LONGEST_PAUSE_MS);
  }
}
