// @ts-check
/** Puts the page together. STOP ALL is made first, so it works even if something after it fails. */

import { Calibrate } from "./calibrate.js";
import { Device } from "./device.js";
import { attribute, byId, text } from "./dom.js";
import { Drive } from "./drive.js";
import { Pad } from "./gamepad.js";
import { Hold, cause } from "./hold.js";
import { Lease } from "./lease.js";
import { Link } from "./link.js";
import { Measured } from "./measured.js";
import { Model } from "./model.js";
import { Numbers } from "./numbers.js";
import { Awake, TAP_MS, offerFullScreen, shake } from "./phone.js";
import { Picture } from "./picture.js";
import { Plots } from "./plots.js";
import { Quality } from "./quality.js";
import { StopAll } from "./stop.js";
import { Targets } from "./targets.js";
import { Upright } from "./upright.js";
import { Walk } from "./walk.js";
import { COMMANDS, ended, news, sentence } from "./words.js";

const REFRESH_MS = 100;

const model = new Model();
/** The newest sentence while it is true; then "". */
let said = () => "";

/** @type {import("./words.js").Say} */
function say(line) {
  const live = model.live(performance.now());
  said = typeof line === "function" ? line : () => (model.live(performance.now()) === live ? line : "");
  text(byId("said"), said());
}

const link = new Link({ opened, closed, received });
const stop = new StopAll(link, model, {
  pressed: () => {
    const why = "STOP ALL was pressed";
    shake(TAP_MS);
    byId("question", HTMLDialogElement).close("no");
    walk.end(why);
    hold.drop(why);
    calibrate.stop(why);
  },
  say,
});
const targets = new Targets();
/** The leg of a hold for one leg. */
let single = model.selectedLeg;
const hold = new Hold(link, model, {
  mine: () => lease.mine,
  chosen: (by) => drive.legsOf(by, single),
  target: (servo, mostDeg) => targets.approach(servo, mostDeg, model.lastDeg.get(servo)),
  busy: () => (walk.active ? "the robot walks; let it sit down first" : ""),
  steer: (elapsedMs) => pad.steer(elapsedMs),
  say,
  begins: () => {
    if (model.whole && !model.runs) targets.lie(Object.entries(model.hello?.lying ?? {}));
  },
  changed: () => {
    if (!hold.active) targets.forget();
    drive.refresh();
  },
});
const lease = new Lease(link, model, {
  say,
  got: () => targets.follow(model.lastDeg, false),
  lost: (why, toDrive) => {
    if (calibrate.active) calibrate.stop(why);
    else if (hold.active) hold.drop(why);
    else {
      walk.end(why);
      hold.why = why; // of a Stop that is reported only now
      const of = cause(walk, why);
      say(() => `${sentence(of())}${toDrive()}`);
    }
  },
});
const calibrate = new Calibrate(link, model, { mine: () => lease.mine, holds: () => hold.active || walk.active, say });
const walk = new Walk(link, model, {
  mine: () => lease.mine,
  old: () => camera?.old ?? false,
  busy: () => (hold.active ? "legs are held; let go first" : calibrate.active ? "a servo is under test; stop it first" : ""),
  say,
});
const drive = new Drive(model, targets, hold, { say, select });
const pad = new Pad(hold, targets, walk, { leg: () => (hold.active ? single : model.selectedLeg), stopAll: () => stop.press(), say });
const numbers = new Numbers(model, select);
const upright = new Upright(link, model, say);
const picture = new Picture(model, select, say, upright);
const measured = new Measured(model);
/** Loaded only if there is a camera. @type {import("./camera.js").Camera | null} */
let camera = null;
const plots = new Plots(model);
const device = new Device(link, say);
const quality = new Quality();
const awake = new Awake();
offerFullScreen(byId("full-screen"), () => stop.press());
byId("more").addEventListener("click", () => {
  const more = document.body.dataset.more !== "yes";
  attribute(document.body, "data-more", more ? "yes" : "no");
  attribute(byId("more"), "aria-expanded", String(more));
  text(byId("more"), more ? "Pads" : "More");
});

/** @param {number} leg */
function select(leg) {
  model.selectedLeg = leg;
  if (!hold.active) single = leg;
  drive.selected();
  refresh();
}

function opened() {
  model.connected = true;
  stop.opened();
  refresh();
}

/** @param {import("./words.js").End} end */
function closed(end) {
  const known = !model.connected && end.cause === "lost" && ["closed", "deaf"].includes(model.end.cause); // and the next attempt failed
  if (!known) model.end = end;
  model.connected = false;
  model.gateway = { type: "link", status: "connecting", detail: "" };
  const { line } = ended(model.end);
  walk.end(line);
  hold.drop(line);
  calibrate.closed(line);
  lease.closed(line);
  refresh();
}

/** @param {any} message of the console */
function received(message) {
  switch (message.type) {
    case "hello":
      model.hello = message;
      Object.assign(COMMANDS, message.commands);
      walk.offer(message.gaits);
      walk.goOn(message.last_id);
      model.forgetEvents(); // the newest ones come again
      if (message.cameras?.length) void import("./camera.js").then(({ Camera }) => (camera ??= new Camera(link, model, say)).begin());
      break;
    case "state":
      if (model.takeState(message.state, message.age_ms, performance.now())) lease.restarted();
      model.now = message.now;
      model.whole = message.whole;
      model.power = message.power ?? "";
      model.unconfirmed = message.unconfirmed ?? "";
      if (!lease.mine) targets.follow(model.lastDeg, false);
      hold.receivedState();
      break;
    case "link":
      model.gateway = message;
      if (lease.mine && message.status !== "connected" && !(walk.driving || hold.active || calibrate.active)) {
        const { line } = ended({ cause: message.status });
        say(() => (model.gateway.status === message.status ? `You cannot drive now: ${line}.` : "")); // the others show this themselves
      }
      break;
    case "event":
      model.takeEvent({ ...message.event, tone: message.tone });
      hold.receivedEvent(message.event);
      if (model.isNew(message.event) && news(message.event)) say(news(message.event));
      break;
    case "telemetry":
      model.takeTelemetry(message.telemetry, performance.now());
      break;
    case "body":
      model.takeBody(message.body, performance.now());
      break;
    case "ack":
      upright.receivedAck(message);
      hold.receivedAck(message);
      calibrate.receivedAck(message);
      stop.receivedAck(message);
      break;
    case "stop":
      stop.received(message);
      break;
    case "calibration":
      calibrate.received(message);
      break;
    case "walk":
      walk.received(message);
      break;
    case "link_for":
      device.received(message);
      break;
    case "lease":
      lease.received(message);
      break;
  }
}

function refresh() {
  const nowMs = performance.now();
  model.look(nowMs, Date.now());
  text(byId("said"), said());
  stop.refresh(nowMs);
  lease.refresh(nowMs);
  walk.refresh(nowMs);
  drive.refresh(nowMs);
  calibrate.refresh();
  awake.want(lease.mine);
  const { bars, known } = quality.take(nowMs, model.live(nowMs) ? model.ageMs(nowMs) : Infinity, walk.active ? walk.answerMs : NaN);
  attribute(byId("quality"), "data-bars", String(bars));
  text(byId("quality-known"), known);
  attribute(document.body, "data-live", model.live(nowMs) ? "yes" : "no");
  if (document.visibilityState !== "visible") return;
  numbers.refresh(nowMs);
  numbers.refreshEvents();
  plots.refresh(nowMs);
  measured.refresh(nowMs, walk.report?.ground ?? "");
  picture.refresh(nowMs, walk.going);
  camera?.refresh(nowMs);
}

setInterval(refresh, REFRESH_MS);
for (const name of ["visibilitychange", "resume"]) document.addEventListener(name, refresh); // not what was true when it was hidden
select(model.selectedLeg);
