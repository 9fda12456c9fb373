// @ts-check
/** Which way it goes and turns: the way of its front in the next seconds, as a line on the ground with an arrow's head. */

const SECONDS = 3;
const STEPS = 24;
/** The front, ahead of the body's middle, in metres. */
const FRONT_M = 0.3;
const HEAD_M = 0.05;
const HEAD_RAD = 2.5;
/** Slower than this it stands, in metres and radians a second. */
const LEAST = 0.002;

/**
 * Points in the body's frame, in metres; the last three are the head. None where it stands.
 * @param {number[]} going forward and left in m/s, turn in rad/s @returns {[number, number][]}
 */
export function course([forward, left, turn]) {
  if (Math.hypot(forward, left, turn) < LEAST) return [];
  let [x, y, heading] = [0, 0, 0];
  /** @type {[number, number][]} */
  const points = [[FRONT_M, 0]];
  for (let step = 0; step < STEPS; step += 1) {
    const seconds = SECONDS / STEPS;
    const middle = heading + (turn * seconds) / 2;
    x += (forward * Math.cos(middle) - left * Math.sin(middle)) * seconds;
    y += (forward * Math.sin(middle) + left * Math.cos(middle)) * seconds;
    heading += turn * seconds;
    points.push([x + FRONT_M * Math.cos(heading), y + FRONT_M * Math.sin(heading)]);
  }
  const [before, tip] = points.slice(-2);
  const toward = Math.atan2(tip[1] - before[1], tip[0] - before[0]);
  const side = (/** @type {number} */ by) => /** @type {[number, number]} */ ([tip[0] + HEAD_M * Math.cos(toward + by), tip[1] + HEAD_M * Math.sin(toward + by)]);
  return [...points, side(HEAD_RAD), tip, side(-HEAD_RAD)];
}
