// @ts-check
/** How the floor moves under the robot: like the standing feet in the body's frame. */

/** @typedef {import("./types.js").Vector} Vector */

/** A foot up to this height above the lowest one stands, in metres. */
const ON_GROUND_M = 0.008;
/** A foot that moved further between two states was set down elsewhere, in metres. */
const FARTHEST_M = 0.08;
const FEWEST = 3;

export class Odometry {
  constructor() {
    /** Where the floor's middle is in the body's frame, and how it is turned. */
    this.x = 0;
    this.y = 0;
    this.turned = 0;
    /** @type {Map<number, Vector>} */
    this.before = new Map();
  }

  /** The feet of the legs that run, in the body's frame. @param {Map<number, Vector>} feet */
  update(feet) {
    const stood = standing(this.before);
    const stands = standing(feet);
    const both = [...stands].filter((leg) => stood.has(leg));
    const pairs = both.map((leg) => ({ from: /** @type {Vector} */ (this.before.get(leg)), to: /** @type {Vector} */ (feet.get(leg)) }));
    this.before = feet;
    if (pairs.length < FEWEST || pairs.some(({ from, to }) => Math.hypot(to[0] - from[0], to[1] - from[1]) > FARTHEST_M)) return;
    const mean = (/** @type {"from" | "to"} */ of, /** @type {0 | 1} */ i) => pairs.reduce((all, pair) => all + pair[of][i], 0) / pairs.length;
    const [fromX, fromY, toX, toY] = [mean("from", 0), mean("from", 1), mean("to", 0), mean("to", 1)];
    let dot = 0;
    let cross = 0;
    for (const { from, to } of pairs) {
      const [ax, ay, bx, by] = [from[0] - fromX, from[1] - fromY, to[0] - toX, to[1] - toY];
      dot += ax * bx + ay * by;
      cross += ax * by - ay * bx;
    }
    const angle = Math.atan2(cross, dot);
    const [c, s] = [Math.cos(angle), Math.sin(angle)];
    const [x, y] = [this.x - fromX, this.y - fromY];
    this.x = toX + c * x - s * y;
    this.y = toY + s * x + c * y;
    this.turned += angle;
  }

  /** Take a simulated body's own pose. @param {import("./types.js").Body} body */
  see({ position_m: [x, y], orientation_xyzw: [i, j, k, w] }) {
    this.before = new Map();
    const heading = Math.atan2(2 * (i * j + w * k), 1 - 2 * (j * j + k * k));
    const [c, s] = [Math.cos(heading), Math.sin(heading)];
    [this.x, this.y, this.turned] = [-(c * x + s * y), s * x - c * y, -heading];
  }

  /** Where the nearest crossing of a grid with this mesh is. @param {number} mesh @returns {[number, number]} */
  crossing(mesh) {
    const [c, s] = [Math.cos(this.turned), Math.sin(this.turned)];
    const along = (c * this.x + s * this.y) % mesh;
    const aside = (c * this.y - s * this.x) % mesh;
    return [c * along - s * aside, s * along + c * aside];
  }
}

/** @param {Map<number, Vector>} feet @returns {Set<number>} */
function standing(feet) {
  const lowest = Math.min(...[...feet.values()].map((foot) => foot[2]));
  return new Set([...feet].filter(([, foot]) => foot[2] < lowest + ON_GROUND_M).map(([leg]) => leg));
}
