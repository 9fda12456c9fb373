// @ts-check
/** The gateway's names for what a robot that measures reports, in plain words. */

/** @type {Record<string, string>} */
const REASONS = {
  battery_low: "the battery is low",
  whole_robot: "on this robot only all six legs start together",
  fallen: "it has fallen, or was lifted",
  no_power: "the power board does not feed it",
};

/** @type {Record<string, string>} */
const NEWS = {
  controller_silent: "The controller is silent: whether its servos stop is not known. Keep clear of the legs, or use the switch.",
  controller_restarted: "The controller may have restarted, so its servos may be slack. Nothing moves until something is pressed.",
  controller_returned: "The controller answers again. Nothing moves until something is pressed.",
  battery_low: "The battery is low. What runs goes on; nothing new starts until it is charged.",
  fallen: "It has fallen, or was lifted: its legs are stopped. Put it on its feet before you start it.",
  power_unconfirmed: "The power board does not confirm that servos are off. Keep clear of the legs, and switch the power off by hand.",
  power_fault: "The power board reports a fault; the events say which. What it has switched off stays off until a reset.",
  servo_draws: "A servo was stopped and still draws current. Keep clear of its leg.",
  servo_silent: "A servo runs and draws nothing: it is unplugged, or broken.",
  off_button: "Somebody pressed the robot's off button: all six legs are stopped.",
};

/** Why something was rejected, with the gateway's own sentence. @param {{reason?: string | null, detail?: string | null}} answer */
export function because({ reason, detail }) {
  return `${REASONS[reason ?? ""] ?? reason}: ${detail ?? ""}`;
}

/** A rejection's reason without its sentence. @param {string} reason */
export function reasonInWords(reason) {
  return REASONS[reason] ?? reason;
}

/** An error's sentence, which names the reason of a rejection. @param {string} sentence */
export function plain(sentence) {
  return sentence.replace(/^rejected: (\w+): /, (all, reason) => (REASONS[reason] ? `${REASONS[reason]}: ` : all));
}

/** What an event means to the driver; "" for one that needs no sentence. @param {{kind: string}} event */
export function news({ kind }) {
  return NEWS[kind] ?? "";
}
