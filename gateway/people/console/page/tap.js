// @ts-check
/** Leads to the console, by its port and the link's token from behind the # of the address, which is never sent. */

const [port, ...token] = location.hash.slice(1).split(",");
const link = document.getElementById("open");
if (link instanceof HTMLAnchorElement && port && token.length) {
  const address = new URL("/", location.href);
  address.protocol = "https:";
  address.port = port;
  address.searchParams.set("token", token.join(","));
  link.href = address.href;
  link.hidden = false;
  document.getElementById("missing")?.remove();
}
