// @ts-check
/** The robot from above, forward up, as SVG: for browsers without WebGL, and by choice. */

import { LEGS, legPoints } from "./kinematics.js";

/** @typedef {import("./types.js").Geometry} Geometry @typedef {import("./scene.js").LegPose} LegPose */

const SVG = "http://www.w3.org/2000/svg";
/** Half of what is shown, in millimetres: a leg stretched out, and its label. */
const REACH = 530;
/** Half of the floor; a picture is wider than high, or the other way round. */
const FLOOR = 1800;
const MESH_M = 0.15;

export class Above {
  /** @param {HTMLElement} place @param {Geometry} geometry */
  constructor(place, geometry) {
    this.geometry = geometry;
    this.place = place;
    this.canvas = node("svg", { viewBox: `${-REACH} ${-REACH} ${2 * REACH} ${2 * REACH}`, class: "above", role: "img" });
    const mounts = Object.values(geometry.leg_mounts).map((mount) => mount.xyz_m);
    const around = [...mounts].sort((a, b) => Math.atan2(a[1], a[0]) - Math.atan2(b[1], b[0]));
    const mesh = String(MESH_M * 1000);
    this.pattern = node("pattern", { id: "mesh", width: mesh, height: mesh, patternUnits: "userSpaceOnUse" });
    this.pattern.append(node("path", { d: `M ${mesh} 0 H 0 V ${mesh}`, class: "mesh" }));
    const all = String(2 * FLOOR);
    this.canvas.append(this.pattern, node("rect", { x: `${-FLOOR}`, y: `${-FLOOR}`, width: all, height: all, fill: "url(#mesh)" }));
    this.canvas.append(node("polygon", { points: around.map(flat).join(" "), class: "body" }));
    const front = Math.max(...mounts.map((mount) => mount[0])) * 1000;
    const tip = `0,${-front * 0.8} ${-front * 0.2},${-front * 0.42} ${front * 0.2},${-front * 0.42}`;
    this.canvas.append(node("polygon", { points: tip, class: "front" }));
    /** @type {Map<number, {group: SVGElement, line: SVGElement, dots: SVGElement[]}>} */
    this.legs = new Map();
    for (const leg of LEGS) {
      const group = node("g", { class: "leg" });
      const line = node("polyline", {});
      const dots = [1, 2, 3, 4].map((place) => node("circle", { r: place === 4 ? "15" : "20" }));
      group.append(line, ...dots);
      this.canvas.append(group);
      this.legs.set(leg, { group, line, dots });
    }
    this.course = node("polygon", { class: "course" });
    this.canvas.append(this.course);
    /** @type {Map<number, LegPose>} */
    this.poses = new Map();
    place.append(this.canvas);
  }

  /**
   * @param {Map<number, LegPose>} poses @param {import("./odometry.js").Odometry} odometry
   * @param {import("./types.js").Body | null} _body @param {[number, number][]} course
   */
  update(poses, odometry, _body, course) {
    this.poses = poses;
    this.course.setAttribute("points", course.map(flat).join(" "));
    const degrees = (-odometry.turned * 180) / Math.PI;
    const crossing = /** @type {[number, number, number]} */ ([...odometry.crossing(MESH_M), 0]);
    this.pattern.setAttribute("patternTransform", `translate(${flat(crossing)}) rotate(${degrees.toFixed(2)})`);
    for (const [leg, pose] of poses) {
      const parts = this.legs.get(leg);
      if (!parts) continue;
      const points = legPoints(this.geometry, leg, pose.trueDegrees ?? pose.degrees);
      parts.group.setAttribute("class", `leg ${pose.status}${pose.selected ? " selected" : ""}`);
      parts.line.setAttribute("points", points.map(flat).join(" "));
      parts.dots[3].setAttribute("class", pose.carries === null ? "" : pose.carries ? "carries" : "hangs");
      parts.dots[3].setAttribute("r", pose.carries === null ? "15" : "24");
      parts.dots.forEach((dot, index) => {
        const [x, y] = flat(points[index + 1]).split(",");
        dot.setAttribute("cx", x);
        dot.setAttribute("cy", y);
      });
    }
  }

  draw() {}

  /** It is always seen from above, its front at the top. */
  chase() {}

  /** @param {number} leg @returns {[number, number]} pixels of the place */
  labelAt(leg) {
    const pose = this.poses.get(leg);
    if (!pose) return [0, 0];
    const points = legPoints(this.geometry, leg, pose.trueDegrees ?? pose.degrees);
    const [mount, foot] = [points[0], points[4]];
    const length = Math.hypot(foot[0] - mount[0], foot[1] - mount[1]) || 1;
    const beyond = [0.08, 0.15]; // a label is wider than high
    const out = (/** @type {0 | 1} */ i) => foot[i] + (beyond[i] * (foot[i] - mount[i])) / length;
    const scale = Math.min(this.place.clientWidth, this.place.clientHeight) / (2 * REACH);
    const x = this.place.clientWidth / 2 - out(1) * 1000 * scale;
    return [x, this.place.clientHeight / 2 - out(0) * 1000 * scale];
  }

  dispose() {
    this.canvas.remove();
  }
}

/** Forward is up and left is left; millimetres. @param {number[]} point */
function flat(point) {
  return `${(-point[1] * 1000).toFixed(1)},${(-point[0] * 1000).toFixed(1)}`;
}

/** @param {string} name @param {Record<string, string>} attributes @returns {SVGElement} */
function node(name, attributes) {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  return made;
}
