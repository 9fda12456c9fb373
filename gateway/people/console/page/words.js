// @ts-check
/** Causes in this viewer's words: why a lease or a link ended, why something was rejected, who did it, what happened. */

import { ago, legs as legsInWords } from "./dom.js";

export const LOOPBACK = /^(127\.|localhost$|\[::1\]$)/;
/** A viewer on the robot's own machine has a terminal there; a phone has none. */
const HAS_TERMINAL = LOOPBACK.test(location.hostname) && !matchMedia("(pointer: coarse)").matches;
/** Letters of a name where the place is narrow. */
const LONGEST_NAME = 18;
const LEGS = 6;
export const UNDRIVEN = "nobody has the lease; ";
const DAY_MS = 86_400_000;

/**
 * @typedef {"connecting" | "offline" | "lost" | "deaf" | "closed" | "rejected" | "signed_out" | "full" | "gone" | "silent" | "old" | "frozen"
 *           | "page_silent" | "taken" | "gateway" | "restarted"} Cause
 * @typedef {{cause: Cause, by?: string | null, forMs?: number, detail?: string | null}} End
 *   `by`: who has the lease now; `forMs`: how long nothing came; `detail`: the technical reason, a line for each host
 */

/** Says what happened. A function is asked again and again, so that its sentence stays true; "" once it is over. @typedef {(line: string | (() => string)) => void} Say */

/** For a viewer with a terminal. The console names its own address: a tunnel's port is none. */
export const COMMANDS = { start: "hexapod-gateway console", link: "hexapod-gateway console --link" };
const AGAIN = "Stay near the robot: this page connects again by itself.";
const ASK = "Ask the person who runs the robot.";
/** Of a cause that has passed. @type {Record<string, string>} */
const PAST = { is: "was", has: "had", does: "did", sends: "sent", accepts: "accepted" };
/** What happened, what to do next, and what a person with a terminal does. @type {Record<Cause, [(end: End) => string, string, (() => string)?]>} */
const CAUSES = {
  connecting: [() => "this page is connecting", ""],
  offline: [() => "this device has no network", "Join the robot's Wi-Fi."],
  lost: [() => "the connection to the console is lost", AGAIN, () => `Start again: ${COMMANDS.start}`],
  deaf: [() => "the console sends nothing", AGAIN],
  closed: [() => "the console was closed", ASK, () => `Start again: ${COMMANDS.start}`],
  rejected: [() => "the console ended the connection", AGAIN],
  signed_out: [() => "this page is not signed in", "Open a new link: ask the person who runs the console.", () => `Make a new link: ${COMMANDS.link}`],
  full: [() => "the network accepts nothing", AGAIN],
  gone: [() => "the console has lost the gateway", ASK, () => "See why it ended: systemctl status hexapod-gateway"],
  silent: [() => "the gateway sends nothing", ASK, () => "See its journal: journalctl -u hexapod-gateway"],
  old: [({ forMs }) => `the newest state is ${ago(forMs ?? 0)} old`, AGAIN],
  frozen: [({ forMs }) => `this page was frozen for ${ago(forMs ?? 0)}`, ""],
  page_silent: [({ forMs }) => `this page was hidden, locked or frozen for ${ago(forMs ?? 0)}, so its lease ended`, ""],
  taken: [({ by }) => `${by} has taken the lease`, ""],
  gateway: [({ forMs }) => `the gateway did not keep this page's lease, which it had last confirmed ${ago(forMs ?? 0)} before`, ""],
  restarted: [() => "the gateway was started again", ""],
};

/**
 * The end of a lease or of a link, by its cause, for this viewer. A remedy that needs a terminal is for a person who has one.
 * @param {End} end @returns {{line: string, next: string, reason: string}} `line` neither begins nor ends a sentence
 */
export function ended(end, terminal = HAS_TERMINAL) {
  const [line, next, typed] = CAUSES[end.cause];
  const reasons = (end.detail ?? "").split("\n").map((each) => (terminal ? each : each.split(" → ")[0]));
  return { line: line(end), next: (terminal && typed?.()) || next, reason: reasons.join("; ") };
}

/** A cause that has passed, without what was to be done about it. @param {string} why */
export function past(why) {
  return why.replace(/; (press|ask|reset) .*/, "").replace(/\b(is|has|does|sends|accepts)\b/g, (verb) => PAST[verb]);
}

/** A sentence that begins so; a name keeps its letters. @param {string} line @param {string[]} [names] */
export function sentence(line, names = []) {
  const first = names.some((name) => line.startsWith(name)) ? line.slice(0, 1) : line.slice(0, 1).toUpperCase();
  return `${first}${line.slice(1)}${line.endsWith("?") ? "" : "."}`;
}

/** @param {string} name */
export function short(name, longest = LONGEST_NAME) {
  return name.length > longest ? `${name.slice(0, longest - 1)}…` : name;
}

/**
 * Who moves which legs though nobody has the lease. @param {import("./types.js").Leg[]} legs @param {(source: string | null) => string} who
 */
export function undriven(legs, who) {
  /** @type {Map<string, number[]>} */
  const movers = new Map();
  for (const { leg, source, servos } of legs) {
    if (!servos.some((servo) => servo.running)) continue;
    const name = source === null ? "a program without a name" : who(source);
    movers.set(name, [...(movers.get(name) ?? []), leg]);
  }
  const moved = [...movers].map(([name, moving]) => `${name} ${name === "you" ? "move" : "moves"} ${moving.length === LEGS ? "all legs" : legsInWords(moving)}`);
  return moved.length ? `${UNDRIVEN}${moved.join(", ")}` : "nobody";
}

/** `12:03`; of another day `26 Nov`, for which a phone has room. @param {string} time RFC 3339 */
export function clock(time) {
  const at = new Date(time);
  if (Math.abs(Date.now() - at.getTime()) < DAY_MS) return at.toLocaleTimeString("en-GB", { hour: "2-digit", minute: "2-digit" });
  return at.toLocaleDateString("en-GB", { day: "numeric", month: "short" });
}

/** The gateway's names for why it rejects a command. @type {Record<string, string>} */
const REASONS = {
  battery_low: "the battery is low",
  whole_robot: "on this robot only all six legs start together",
  fallen: "it has fallen, or was lifted",
  no_power: "the power board does not feed it",
  stale: "it came too late",
  servo_stopped: "the servo is stopped, so it has to be started first",
  joint_limit: "the servo may not go there",
  estopped: "STOP ALL is engaged; reset it first",
  bus_fault: "the controller does not answer",
  stopping: "the gateway ends",
  not_holder: "this page does not have the lease",
  no_lease: "nobody has the lease",
  lease_held: "somebody else has the lease",
  lease_denied: "the gateway denies this page the lease",
  landing: "the robot puts its legs down",
  overflow: "too many commands came at once",
  no_button: "a required stop button is missing",
  unknown_button: "the gateway does not know this button",
  button_denied: "the gateway does not accept this button",
};

/** @type {Record<string, string>} */
const NEWS = {
  controller_silent: "The controller is silent: whether its servos stop is not known. Keep clear of the legs, or use the switch.",
  controller_restarted: "The controller may have restarted, so its servos may be slack. Nothing moves until something is pressed.",
  controller_returned: "The controller answers again. Nothing moves until something is pressed.",
  battery_low: "The battery is low. Running servos continue; no other starts until it is charged.",
  fallen: "It has fallen, or was lifted: its legs are stopped. Put it on its feet before you start it.",
  power_unconfirmed: "The power board does not confirm that servos are off. Keep clear of the legs, and switch the power off by hand.",
  power_fault: "The power board reports a fault; see the events. Servos that it switched off stay off until a reset.",
  servo_draws: "A servo was stopped and still draws current. Keep clear of its leg.",
  servo_silent: "A servo runs and draws nothing: it is unplugged, or broken.",
  off_button: "Somebody pressed the robot's off button: all six legs are stopped.",
};

/** Why something was rejected, with the gateway's own sentence. @param {{reason?: string | null, detail?: string | null}} answer */
export function because({ reason, detail }) {
  return [reason && reasonInWords(reason), detail].filter(Boolean).join(": ");
}

/** A rejection's reason without its sentence. @param {string} reason */
export function reasonInWords(reason) {
  return REASONS[reason] ?? reason.replaceAll("_", " ");
}

/** An error's sentence, which names the reason of a rejection. @param {string} sentence */
export function plain(sentence) {
  return sentence.replace(/^rejected: (\w+): /, (all, reason) => (REASONS[reason] ? `${REASONS[reason]}: ` : all));
}

/** What an event means to the driver; "" for one that needs no sentence. @param {{kind: string}} event */
export function news({ kind }) {
  return NEWS[kind] ?? "";
}

/**
 * The gateway's sentence in this page's words: a button on a screen is no emergency stop device (ISO 13850).
 * @param {string} sentence
 */
export function worded(sentence) {
  return sentence.replace(/\b(?:an|the) emergency stop\b/gi, "STOP ALL").replace(/\bemergency stop\b/gi, "STOP ALL");
}
