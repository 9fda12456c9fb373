// @ts-check
/**
 * The session's key, which the browser keeps for this origin: this scheme, host and port. The cookie alone opens
 * nothing: it also goes to other ports of this host, where somebody else may listen.
 */

const NAME = "hexapod-console-key";
const PREFIX = "key.";
const SUBPROTOCOL = "hexapod-console";

/** Keep the key of a new session. @param {string} key */
export function keep(key) {
  localStorage.setItem(NAME, key);
}

/** What a WebSocket offers: a request of its kind has no other place for the key. */
export function subprotocols() {
  const key = kept();
  return key ? [SUBPROTOCOL, PREFIX + key] : [SUBPROTOCOL];
}

/** What other requests carry. */
export function headers() {
  return { "X-Console-Key": kept() };
}

function kept() {
  try {
    return localStorage.getItem(NAME) ?? "";
  } catch {
    return ""; // this browser keeps nothing
  }
}
