// @ts-check
/** The ground below a robot that is simulated with physics: level, or rising toward where it looked at first. */

/** @param {string} terrain as `run --terrain` names it */
export function slopeRad(terrain) {
  return terrain.startsWith("slope:") ? (Number(terrain.slice(6)) * Math.PI) / 180 : 0;
}

/** How far the ground below it is. @param {import("./types.js").Body} body */
export function heightAbove({ position_m: [x, , z], terrain }) {
  return z - x * Math.tan(slopeRad(terrain));
}

/** How it leans against the ground: 1 stands, -1 lies on its back. @param {import("./types.js").Body} body */
export function upAgainst({ orientation_xyzw: [x, y, z, w], terrain }) {
  const slope = slopeRad(terrain);
  return Math.cos(slope) * (1 - 2 * (x * x + y * y)) - Math.sin(slope) * 2 * (x * z + w * y);
}
