// @ts-check
/** The path of the robot's front in the next seconds, as an arrow. */

const SECONDS = 4;
const STEPS = 24;
/** The front, ahead of the body's middle, in metres. */
const FRONT_M = 0.3;
const HALF_M = 0.012;
const HEAD_M = 0.045;
/** A slower robot counts as standing, in m/s and rad/s. */
const LEAST = 0.002;

/**
 * The arrow's outline in the body's frame, in metres, its tip in the middle of the list. Empty where it stands.
 * @param {number[]} going forward and left in m/s, turn in rad/s @returns {[number, number][]}
 */
export function course([forward, left, turn]) {
  if (Math.hypot(forward, left, turn) < LEAST) return [];
  const seconds = SECONDS / STEPS;
  let [x, y, heading] = [0, 0, 0];
  /** @type {[number, number][][]} */
  const [lefts, rights] = [[], []];
  for (let step = 0; step <= STEPS; step += 1) {
    const [ahead, aside] = [FRONT_M * Math.cos(heading), FRONT_M * Math.sin(heading)];
    const [c, s] = [Math.cos(heading), Math.sin(heading)];
    const [goesX, goesY] = [c * forward - s * left - turn * aside, s * forward + c * left + turn * ahead];
    const speed = Math.hypot(goesX, goesY) || 1;
    const at = (/** @type {number} */ along, /** @type {number} */ across) =>
      /** @type {[number, number]} */ ([x + ahead + (along * goesX - across * goesY) / speed, y + aside + (along * goesY + across * goesX) / speed]);
    lefts.push(at(0, HALF_M));
    rights.unshift(at(0, -HALF_M));
    if (step === STEPS) lefts.push(at(0, HEAD_M), at(2 * HEAD_M, 0), at(0, -HEAD_M));
    const middle = heading + (turn * seconds) / 2;
    x += (forward * Math.cos(middle) - left * Math.sin(middle)) * seconds;
    y += (forward * Math.sin(middle) + left * Math.cos(middle)) * seconds;
    heading += turn * seconds;
  }
  return [...lefts, ...rights];
}
