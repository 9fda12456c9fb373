// @ts-check
/** The WebSocket to the console: messages in, messages out, and a new one wherever it ends. */

import { subprotocols } from "./key.js";

const FIRST_PAUSE_MS = 250;
const LONGEST_PAUSE_MS = 2000;
const ALIVE_EVERY_MS = 1000;
/** What the browser keeps unsent beyond this waits for a network that is gone. */
const MOST_UNSENT_BYTES = 4096;
const REJECTED = 1008;
/** A connection on which nothing comes for so long is given up: a phone that changed its network waits for minutes. */
const DEAF_MS = 5000;

export class Link {
  /**
   * @param {{
   *   opened: () => void,
   *   closed: (why: string) => void,
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
    /** When something was heard, or a connection was begun. */
    this.receivedMs = performance.now();
    setInterval(() => {
      this.sendNow({ type: "alive", now_ms: performance.now() });
      this.renewIfDeaf(DEAF_MS);
    }, ALIVE_EVERY_MS);
    void this.#connect();
  }

  /** A number of this page's own, which the answer repeats. */
  nextId() {
    this.lastId += 1;
    return this.lastId;
  }

  /**
   * Send it now or never: nothing that moves a servo may wait for a network that comes back.
   * @param {object} message @returns {boolean} whether it was given to the network
   */
  sendNow(message) {
    if (!this.open || !this.socket || this.socket.bufferedAmount > MOST_UNSENT_BYTES) return false;
    this.socket.send(JSON.stringify(message));
    return true;
  }

  /** Send a Stop, behind whatever waits: it does no harm however late it comes. @param {object} message */
  sendStop(message) {
    if (!this.open || !this.socket) return false;
    this.socket.send(JSON.stringify(message));
    return true;
  }

  /** Try a new connection, if there is one on which nothing was heard for so long. @param {number} ms */
  renewIfDeaf(ms) {
    const { socket } = this;
    if (!socket || performance.now() - this.receivedMs < ms) return;
    this.open = false;
    this.socket = null;
    socket.close(); // whatever it still says is not heard
    this.callbacks.closed("nothing is heard from the console");
    void this.#connect();
  }

  async #connect() {
    this.receivedMs = performance.now();
    let offered;
    try {
      offered = await subprotocols(DEAF_MS);
    } catch (error) {
      this.callbacks.closed(error instanceof Error ? error.message : "");
      this.#again();
      return;
    }
    this.receivedMs = performance.now();
    const address = new URL("ws", location.href);
    address.protocol = location.protocol === "https:" ? "wss:" : "ws:";
    const socket = new WebSocket(address, offered);
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
    this.callbacks.closed(event.code === REJECTED || event.reason ? event.reason || "the console ended the connection" : "");
    this.#again();
  }

  #again() {
    setTimeout(() => void this.#connect(), this.pauseMs);
    this.pauseMs = Math.min(this.pauseMs * 2, LONGEST_PAUSE_MS);
  }
}
