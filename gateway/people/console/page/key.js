// @ts-check
/**
 * The session's key, which the browser stores for this origin: this scheme, host and port. The cookie alone is not
 * enough, since browsers send it to other ports of this host, where another program may listen.
 *
 * The key is never sent, since another program may listen at this port too while the console is started again. Page and
 * console prove to each other that they know it, the console first (`auth.py`).
 */

const NAME = "hexapod-console-key";
const TAB = "hexapod-console-tab";
const FORBIDDEN = 403;
const bytes = new TextEncoder();

/** Store the key of a new session. @param {string} key */
export function keep(key) {
  localStorage.setItem(NAME, key);
}

/**
 * What a WebSocket's address carries, once the console has proved that it knows the key. Throws an Error with the
 * reason, and its cause (`words.js`), if it has not.
 * @param {number} timeoutMs
 */
export async function proved(timeoutMs) {
  const mine = hex(crypto.getRandomValues(new Uint8Array(16)));
  const answer = await asked(`session?nonce=${mine}`, timeoutMs);
  if (answer.proof !== (await proof(`console ${mine} ${answer.nonce}`))) {
    throw new Error("What answers does not know this page's key, so another program may listen here", { cause: "signed_out" });
  }
  return { nonce: answer.nonce ?? "", proof: await proof(`page ${answer.nonce}`) };
}

/** The name of this tab. It stays after a reload, so the console knows which tab drove. */
export function tab() {
  const name = sessionStorage.getItem(TAB) ?? hex(crypto.getRandomValues(new Uint8Array(16)));
  sessionStorage.setItem(TAB, name);
  return name;
}

/** @param {string} address @param {number} timeoutMs @returns {Promise<{nonce?: string, proof?: string}>} */
async function asked(address, timeoutMs) {
  let answer;
  try {
    answer = await fetch(address, { cache: "no-store", signal: AbortSignal.timeout(timeoutMs) });
  } catch {
    throw new Error("The console does not answer", { cause: navigator.onLine ? "lost" : "offline" });
  }
  const text = await answer.text();
  if (!answer.ok) throw new Error(text.trim(), { cause: answer.status === FORBIDDEN ? "signed_out" : "rejected" });
  try {
    return JSON.parse(text);
  } catch {
    return {}; // of another program
  }
}

/** @param {string} text */
async function proof(text) {
  const secret = bytes.encode(hex(await crypto.subtle.digest("SHA-256", bytes.encode(kept()))));
  const key = await crypto.subtle.importKey("raw", secret, { name: "HMAC", hash: "SHA-256" }, false, ["sign"]);
  return hex(await crypto.subtle.sign("HMAC", key, bytes.encode(text)));
}

/** @param {ArrayBuffer | Uint8Array} found */
function hex(found) {
  return Array.from(new Uint8Array(found), (byte) => byte.toString(16).padStart(2, "0")).join("");
}

function kept() {
  try {
    return localStorage.getItem(NAME) ?? "";
  } catch {
    return ""; // this browser keeps nothing
  }
}
