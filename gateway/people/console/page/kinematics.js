// @ts-check
/** From servo degrees to places in the body's frame (x forward, y left, z up; metres). The numbers are the file's. */

/** @typedef {import("./types.js").Geometry} Geometry @typedef {import("./types.js").Vector} Vector */
/** Rows of a rotation. @typedef {[Vector, Vector, Vector]} Rotation */

export const LEGS = [1, 2, 3, 4, 5, 6];
export const JOINTS = [1, 2, 3];
/** Where a servo is drawn that was never commanded. */
export const NEUTRAL_DEG = 90;

/** The joint's angle, where the servo stands at `deg`. @param {Geometry} geometry @param {number} servo @param {number} deg */
export function jointRad(geometry, servo, deg) {
  const { zero_deg: zero, direction } = geometry.servos[servo];
  return (((deg - zero) * Math.PI) / 180) * direction;
}

/**
 * A leg's mount, its three joints and its foot, in this order.
 * @param {Geometry} geometry @param {number} leg @param {number[]} degrees of its three servos
 * @returns {Vector[]}
 */
export function legPoints(geometry, leg, degrees) {
  const mount = geometry.leg_mounts[leg];
  let at = mount.xyz_m;
  let turned = fromRpy([0, 0, mount.yaw_rad]);
  const points = [at];
  for (const joint of JOINTS) {
    const link = geometry.chain[joint - 1];
    at = plus(at, rotated(turned, link.origin_xyz_m));
    const moved = about(link.axis ?? [0, 0, 1], jointRad(geometry, leg * 10 + joint, degrees[joint - 1]));
    turned = times(times(turned, fromRpy(link.origin_rpy_rad ?? [0, 0, 0])), moved);
    points.push(at);
  }
  points.push(plus(at, rotated(turned, geometry.chain[3].origin_xyz_m)));
  return points;
}

/** @param {Vector} a @param {Vector} b @returns {Vector} */
function plus(a, b) {
  return [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
}

/** @param {Vector} a @param {Vector} b */
function dot(a, b) {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/** @param {Rotation} rotation @param {Vector} vector @returns {Vector} */
function rotated(rotation, vector) {
  return [dot(rotation[0], vector), dot(rotation[1], vector), dot(rotation[2], vector)];
}

/** @param {Rotation} a @param {Rotation} b @returns {Rotation} */
function times(a, b) {
  const columns = [0, 1, 2].map((i) => /** @type {Vector} */ ([b[0][i], b[1][i], b[2][i]]));
  const row = (/** @type {Vector} */ of) => /** @type {Vector} */ (columns.map((column) => dot(of, column)));
  return [row(a[0]), row(a[1]), row(a[2])];
}

/** The rotation by an angle about an axis of length 1. @param {Vector} axis @param {number} angle @returns {Rotation} */
function about([x, y, z], angle) {
  const s = Math.sin(angle);
  const c = Math.cos(angle);
  const t = 1 - c;
  return [
    [t * x * x + c, t * x * y - s * z, t * x * z + s * y],
    [t * x * y + s * z, t * y * y + c, t * y * z - s * x],
    [t * x * z - s * y, t * y * z + s * x, t * z * z + c],
  ];
}

/** Roll, pitch and yaw as in a URDF. @param {Vector} rpy @returns {Rotation} */
function fromRpy([roll, pitch, yaw]) {
  return times(times(about([0, 0, 1], yaw), about([0, 1, 0], pitch)), about([1, 0, 0], roll));
}
