// @ts-check
/** Small helpers. Nothing here touches the page where it would look the same: so nothing flickers at 10 Hz. */

/**
 * The element with this id, which the page has, and of this class.
 * @template {HTMLElement} [E=HTMLElement]
 * @param {string} id @param {{new (): E}} [kind] @returns {E}
 */
export function byId(id, kind = /** @type {any} */ (HTMLElement)) {
  const found = document.getElementById(id);
  if (!(found instanceof kind)) throw new Error(`the page has no ${kind.name} #${id}`);
  return found;
}

/** @param {Node} node @param {string} value */
export function text(node, value) {
  if (node.textContent !== value) node.textContent = value;
}

/** @param {Element} node @param {string} name @param {string | null} value null: without the attribute */
export function attribute(node, name, value) {
  if (node.getAttribute(name) === value) return;
  if (value === null) node.removeAttribute(name);
  else node.setAttribute(name, value);
}

/** @param {HTMLElement} node @param {boolean} shown */
export function show(node, shown) {
  if (node.hidden === shown) node.hidden = !shown;
}

/** @param {HTMLButtonElement | HTMLInputElement} node @param {boolean} enabled */
export function enable(node, enabled) {
  if (node.disabled === enabled) node.disabled = !enabled;
}

/**
 * @template {keyof HTMLElementTagNameMap} Tag
 * @param {Tag} tag
 * @param {Record<string, string>} attributes
 * @param {...(Node | string)} children
 * @returns {HTMLElementTagNameMap[Tag]}
 */
export function element(tag, attributes, ...children) {
  const node = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) node.setAttribute(name, value);
  node.append(...children);
  return node;
}

const TEXT_FIELDS = new Set(["text", "search", "email", "url", "password"]);

/** Whether letters and spaces are being typed into it. @param {EventTarget | null} target */
export function typesText(target) {
  return target instanceof HTMLInputElement && TEXT_FIELDS.has(target.type);
}

/** An age for people. @param {number} ms */
export function ago(ms) {
  if (ms < 10_000) return `${(ms / 1000).toFixed(1)} s`;
  if (ms < 120_000) return `${Math.round(ms / 1000)} s`;
  return ms < 7_200_000 ? `${Math.round(ms / 60_000)} min` : `${Math.round(ms / 3_600_000)} h`;
}

/** "legs 1, 3 and 4". @param {number[]} legs */
export function legs(legs) {
  const sorted = [...legs].sort((a, b) => a - b).map(String);
  if (sorted.length <= 1) return `leg ${sorted[0] ?? "–"}`;
  return `legs ${sorted.slice(0, -1).join(", ")} and ${sorted.at(-1)}`;
}

/**
 * Ask before something is done. Resolves to false where it is closed in any other way than by the button that means yes.
 * It is not modal: STOP ALL stays within reach.
 * @param {string} question @param {string} explanation @param {string} yes @param {string} no
 * @returns {Promise<boolean>}
 */
export function confirmed(question, explanation, yes, no) {
  const dialog = byId("question", HTMLDialogElement);
  if (dialog.open) return Promise.resolve(false); // one question at a time
  const before = document.activeElement;
  text(byId("question-title"), question);
  text(byId("question-text"), explanation);
  text(byId("question-yes"), yes);
  text(byId("question-no"), no);
  dialog.show();
  byId("question-no").focus();
  return new Promise((resolve) => {
    const closed = () => {
      if (before instanceof HTMLElement) before.focus();
      resolve(dialog.returnValue === "yes");
    };
    dialog.addEventListener("close", closed, { once: true });
  });
}
