// @ts-check
/** After a link was exchanged for a session: stores its key, from behind the # of the address, and opens the page. */

import { keep } from "./key.js";

try {
  const key = location.hash.slice(1);
  if (key) keep(key);
  location.replace(`./${location.search.replace("?", "#")}`); // to a card of the page, where the link names one
} catch {
  const line = document.getElementById("enter");
  if (line) line.textContent = "This browser stores nothing for this page, so you cannot be signed in. Allow it, and open another link.";
}
