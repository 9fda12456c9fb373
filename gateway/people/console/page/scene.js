// @ts-check
/** The robot in three dimensions, drawn with three.js only when something has changed. */

import * as three from "./vendor/three/three.js";

import { JOINTS, LEGS, jointRad, legPoints } from "./kinematics.js";
import { heightAbove, slopeRad } from "./terrain.js";

/** @typedef {import("./types.js").Geometry} Geometry @typedef {import("./types.js").Vector} Vector */
/** @typedef {{degrees: number[], trueDegrees: number[] | null, status: string, selected: boolean, carries: boolean | null}} LegPose */

const NEAREST_M = 0.5;
const FARTHEST_M = 2.5;
const LABEL_M = 0.1;
const PLATE_M = 0.006;
const GAP_M = 0.036;
const MESH_M = 0.15;
const LINES = 7;
/** Above the legs' mounts: on the ground, seen from behind, the body hides it. */
const COURSE_M = 0.06;
const TURN_PER_PIXEL = 0.008;
const TURN_PER_KEY = Math.PI / 24;
/** The factor by which a foot with a force sensor is drawn larger, and the opacity of one that carries nothing. */
const CARRIES = 2.2;
const HANGS = 1.6;
const HANGS_OPACITY = 0.3;

/** @type {Record<string, {opacity: number, wireframe: boolean, variable: string}>} */
const LOOKS = {
  runs: { opacity: 1, wireframe: false, variable: "--runs" },
  waits: { opacity: 0.55, wireframe: false, variable: "--waits" },
  stopped: { opacity: 1, wireframe: true, variable: "--stopped" },
  rests: { opacity: 0.5, wireframe: false, variable: "--rests" },
  other: { opacity: 0.5, wireframe: false, variable: "--rests" },
};

export class Scene {
  /** Throws where the browser has no WebGL. @param {HTMLElement} place @param {Geometry} geometry @param {() => void} lost */
  constructor(place, geometry, lost) {
    this.geometry = geometry;
    this.place = place;
    this.renderer = new three.WebGLRenderer({ antialias: true, alpha: true, powerPreference: "low-power" });
    this.renderer.shadowMap.enabled = true;
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
    this.canvas = this.renderer.domElement;
    this.canvas.tabIndex = 0;
    this.canvas.setAttribute("role", "img");
    this.canvas.addEventListener("webglcontextlost", lost);
    place.append(this.canvas);

    this.pixel = new Uint8Array(4);
    this.scene = new three.Scene();
    this.camera = new three.PerspectiveCamera(32, 1, 0.05, 10);
    this.camera.up.set(0, 0, 1);
    this.azimuth = this.elevation = 0;
    this.distance = 1.55;
    this.chase();
    this.centre = new three.Vector3(0, 0, -0.11);

    this.scene.add(new three.HemisphereLight(0xffffff, 0x8890a0, 1.6));
    const sun = new three.DirectionalLight(0xffffff, 2.2);
    sun.position.set(0.6, 0.8, 1.6);
    sun.castShadow = true;
    sun.shadow.mapSize.set(1024, 1024);
    sun.shadow.radius = 6;
    const box = sun.shadow.camera;
    [box.left, box.right, box.top, box.bottom, box.near, box.far] = [-0.7, 0.7, 0.7, -0.7, 0.1, 4];
    this.scene.add(sun);

    this.ground = new three.Group();
    const shadow = new three.Mesh(
      new three.CircleGeometry(0.75, 64),
      new three.ShadowMaterial({ opacity: 0.22, depthWrite: false }),
    );
    shadow.receiveShadow = true;
    this.meshMaterial = new three.LineBasicMaterial({ transparent: true, opacity: 0.8 });
    this.mesh = mesh(this.meshMaterial);
    this.ground.add(this.mesh, shadow);
    this.scene.add(this.ground);
    /** All of the robot: turned as the body is, above a ground that stays level. */
    this.robot = new three.Group();
    this.scene.add(this.robot);
    // Drawn last, and over a leg that is where it was sent.
    this.ghostMaterial = new three.LineBasicMaterial({ depthTest: false, transparent: true });
    this.ghost = new three.LineSegments(new three.BufferGeometry(), this.ghostMaterial);
    this.ghost.renderOrder = 1;
    this.robot.add(this.ghost);
    this.courseMaterial = new three.MeshBasicMaterial({ side: three.DoubleSide });
    this.course = new three.Mesh(new three.BufferGeometry(), this.courseMaterial);
    this.course.position.z = COURSE_M;
    this.robot.add(this.course);

    this.bodyMaterial = new three.MeshStandardMaterial({ roughness: 0.7, metalness: 0.1 });
    this.servoMaterial = new three.MeshStandardMaterial({ roughness: 0.5, metalness: 0.2 });
    this.frontMaterial = new three.MeshStandardMaterial({ roughness: 0.6 });
    this.#body();
    this.legs = new Map(LEGS.map((leg) => [leg, this.#leg(leg)]));
    /** @type {Map<number, LegPose>} */
    this.poses = new Map();

    this.#orbit();
    this.watcher = new ResizeObserver(() => this.draw());
    this.watcher.observe(place);
    this.scheme = matchMedia("(prefers-color-scheme: dark)");
    this.recoloured = () => {
      this.#recolour();
      this.draw();
    };
    this.scheme.addEventListener("change", this.recoloured);
    this.#recolour();
  }

  /** From behind, so that ahead on a pad is ahead in the picture. */
  chase() {
    this.azimuth = Math.PI;
    this.elevation = 0.7;
  }

  /**
   * @param {Map<number, LegPose>} poses @param {import("./odometry.js").Odometry} odometry
   * @param {import("./types.js").Body | null} body @param {[number, number][]} course in metres
   */
  update(poses, odometry, body, course = []) {
    this.poses = poses;
    this.mesh.position.set(...odometry.crossing(MESH_M), 0);
    this.mesh.rotation.z = odometry.turned;
    this.#turn(body);
    this.#drawGhost(body ? poses : new Map());
    let lowest = 0;
    for (const [leg, pose] of poses) {
      const parts = this.legs.get(leg);
      if (!parts) continue;
      parts.joints.forEach((joint, index) => {
        joint.setRotationFromAxisAngle(parts.axes[index], jointRad(this.geometry, leg * 10 + index + 1, (pose.trueDegrees ?? pose.degrees)[index]));
      });
      this.#look(parts.material, pose.status);
      this.#look(parts.foot.material, pose.status, pose.carries);
      parts.foot.scale.setScalar(pose.carries === null ? 1 : pose.carries ? CARRIES : HANGS);
      parts.ring.visible = pose.selected && !body;
      const foot = legPoints(this.geometry, leg, pose.degrees)[4];
      parts.ring.position.set(foot[0], foot[1], 0.001);
      lowest = Math.min(lowest, foot[2]);
    }
    this.ground.position.z = body ? -heightAbove(body) : lowest - 0.012;
    for (const parts of this.legs.values()) parts.ring.position.z = this.ground.position.z + 0.002;
    this.course.visible = course.length > 0;
    if (course.length) {
      this.course.geometry.dispose();
      this.course.geometry = new three.ShapeGeometry(new three.Shape(course.map(([x, y]) => new three.Vector2(x, y))));
    }
    this.draw();
  }

  /** As the body leans, seen from behind it: which way it heads shows in the floor. @param {import("./types.js").Body | null} body */
  #turn(body) {
    const turned = new three.Quaternion();
    this.ground.quaternion.identity();
    if (body) {
      turned.set(...body.orientation_xyzw);
      const ahead = new three.Vector3(1, 0, 0).applyQuaternion(turned);
      const heading = new three.Quaternion().setFromAxisAngle(new three.Vector3(0, 0, 1), Math.atan2(ahead.y, ahead.x));
      const slope = new three.Quaternion().setFromAxisAngle(new three.Vector3(0, 1, 0), -slopeRad(body.terrain));
      this.ground.quaternion.copy(slope.multiply(heading)).premultiply(heading.invert());
      turned.premultiply(heading);
    }
    this.robot.quaternion.copy(turned);
  }

  /** Legs that run, as they are commanded, next to where they are. @param {Map<number, LegPose>} poses */
  #drawGhost(poses) {
    const points = [];
    for (const [leg, pose] of poses) {
      if (pose.status !== "runs") continue;
      const line = legPoints(this.geometry, leg, pose.degrees).map((point) => new three.Vector3(...point));
      for (let part = 1; part < line.length; part += 1) points.push(line[part - 1], line[part]);
    }
    this.ghost.geometry.dispose();
    this.ghost.geometry = new three.BufferGeometry().setFromPoints(points); // one that was made for fewer points takes no more
    this.ghost.visible = points.length > 0;
  }

  draw() {
    const width = this.place.clientWidth;
    const height = this.place.clientHeight;
    if (!width || !height) return;
    const size = this.renderer.getSize(new three.Vector2());
    if (size.x !== width || size.y !== height) this.renderer.setSize(width, height);
    this.camera.aspect = width / height;
    const wide = Math.max(1, 1.25 / this.camera.aspect);
    const across = Math.cos(this.elevation) * this.distance * wide;
    this.camera.position.set(
      this.centre.x + across * Math.cos(this.azimuth),
      this.centre.y + across * Math.sin(this.azimuth),
      this.centre.z + Math.sin(this.elevation) * this.distance * wide,
    );
    this.camera.lookAt(this.centre);
    this.camera.updateProjectionMatrix();
    this.renderer.render(this.scene, this.camera);
    const context = this.renderer.getContext();
    context.readPixels(0, 0, 1, 1, context.RGBA, context.UNSIGNED_BYTE, this.pixel); // waits, so that its time is known
  }

  /** Where a leg's label belongs, in pixels of the place: on the ground, beyond its foot. @param {number} leg @returns {[number, number]} */
  labelAt(leg) {
    const pose = this.poses.get(leg);
    if (!pose) return [0, 0];
    const points = legPoints(this.geometry, leg, pose.trueDegrees ?? pose.degrees);
    const [mount, foot] = [points[0], points[4]];
    const length = Math.hypot(foot[0] - mount[0], foot[1] - mount[1]) || 1;
    const out = (/** @type {0 | 1} */ i) => foot[i] + (LABEL_M * (foot[i] - mount[i])) / length;
    return this.at(new three.Vector3(out(0), out(1), foot[2]).applyQuaternion(this.robot.quaternion));
  }

  /** Where a point is seen, in pixels of the place. @param {import("./vendor/three/three.js").Vector3} point @returns {[number, number]} */
  at(point) {
    const { x, y } = point.clone().project(this.camera);
    return [((x + 1) / 2) * this.place.clientWidth, ((1 - y) / 2) * this.place.clientHeight];
  }

  dispose() {
    this.watcher.disconnect();
    this.scheme.removeEventListener("change", this.recoloured);
    this.renderer.dispose();
    this.canvas.remove();
  }

  #body() {
    const mounts = Object.values(this.geometry.leg_mounts).map((mount) => mount.xyz_m);
    const around = [...mounts].sort((a, b) => Math.atan2(a[1], a[0]) - Math.atan2(b[1], b[0]));
    const shape = new three.Shape();
    const inset = 0.97;
    around.forEach(([x, y], index) => (index ? shape.lineTo(x * inset, y * inset) : shape.moveTo(x * inset, y * inset)));
    shape.closePath();
    const bevel = { bevelEnabled: true, bevelSize: 0.018, bevelThickness: 0.002, bevelSegments: 3 };
    const plate = new three.ExtrudeGeometry(shape, { depth: PLATE_M, ...bevel });
    const height = mounts[0][2];
    for (const z of [height - PLATE_M / 2, height + GAP_M + PLATE_M]) {
      const mesh = new three.Mesh(plate, this.bodyMaterial);
      mesh.position.z = z;
      mesh.castShadow = mesh.receiveShadow = true;
      this.robot.add(mesh);
    }
    const foremost = Math.max(...mounts.map((mount) => mount[0]));
    const arrow = new three.Shape();
    arrow.moveTo(foremost * 0.82, 0);
    arrow.lineTo(foremost * 0.45, foremost * 0.2);
    arrow.lineTo(foremost * 0.45, -foremost * 0.2);
    arrow.closePath();
    const front = new three.Mesh(new three.ExtrudeGeometry(arrow, { depth: 0.004, bevelEnabled: false }), this.frontMaterial);
    front.position.z = height + GAP_M + 2 * PLATE_M + 0.003;
    this.robot.add(front);
  }

  /** @param {number} leg */
  #leg(leg) {
    const { leg_mounts: mounts, chain } = this.geometry;
    const material = new three.MeshStandardMaterial({ roughness: 0.55, metalness: 0.05, transparent: true });
    const mount = new three.Group();
    mount.position.set(...mounts[leg].xyz_m);
    mount.rotation.z = mounts[leg].yaw_rad;
    this.robot.add(mount);
    /** @type {three.Object3D} */
    let parent = mount;
    const joints = [];
    const axes = [];
    for (const number of JOINTS) {
      const link = chain[number - 1];
      const frame = new three.Group();
      frame.position.set(...link.origin_xyz_m);
      frame.rotation.set(...(link.origin_rpy_rad ?? /** @type {Vector} */ ([0, 0, 0])), "ZYX");
      const joint = new three.Group();
      const axis = new three.Vector3(...(link.axis ?? /** @type {Vector} */ ([0, 0, 1])));
      frame.add(joint);
      parent.add(frame);
      joint.add(this.#servo(axis));
      joint.add(limb(new three.Vector3(...chain[number].origin_xyz_m), number, material));
      joints.push(joint);
      axes.push(axis);
      parent = joint;
    }
    const foot = new three.Mesh(new three.SphereGeometry(0.011, 20, 14), material.clone());
    foot.position.set(...chain[3].origin_xyz_m);
    foot.castShadow = true;
    parent.add(foot);
    const ring = circle(0.035, new three.LineBasicMaterial());
    this.scene.add(ring);
    return { material, foot, joints, axes, ring };
  }

  /** @param {three.Vector3} axis */
  #servo(axis) {
    const mesh = new three.Mesh(new three.CylinderGeometry(0.017, 0.017, 0.044, 24), this.servoMaterial);
    mesh.quaternion.setFromUnitVectors(new three.Vector3(0, 1, 0), axis.clone().normalize());
    mesh.castShadow = true;
    return mesh;
  }

  /** @param {three.MeshStandardMaterial} material @param {string} status @param {boolean | null} filled null: as the status is */
  #look(material, status, filled = null) {
    const { userData } = material;
    if (userData.status === status && userData.filled === filled) return;
    Object.assign(userData, { status, filled });
    const look = LOOKS[status] ?? LOOKS.other;
    material.opacity = filled === null ? look.opacity : filled ? 1 : HANGS_OPACITY;
    material.wireframe = filled === null && look.wireframe;
    material.color.set(colour(look.variable));
    material.needsUpdate = true;
  }

  #recolour() {
    this.bodyMaterial.color.set(colour("--body"));
    this.servoMaterial.color.set(colour("--servo"));
    this.frontMaterial.color.set(colour("--accent"));
    this.meshMaterial.color.set(colour("--faint"));
    this.ghostMaterial.color.set(colour("--accent"));
    this.courseMaterial.color.set(colour("--accent"));
    for (const parts of this.legs.values()) {
      /** @type {three.LineBasicMaterial} */ (parts.ring.material).color.set(colour("--accent"));
      for (const material of [parts.material, parts.foot.material]) {
        const { status, filled } = material.userData;
        material.userData.status = undefined;
        this.#look(material, status ?? "rests", filled);
      }
    }
  }

  /** Turn it by dragging, with the arrow keys, and nearer and farther with the wheel. */
  #orbit() {
    let dragging = false;
    const turned = (/** @type {number} */ x, /** @type {number} */ y) => {
      this.azimuth -= x;
      this.elevation = Math.min(1.55, Math.max(-0.2, this.elevation + y));
      this.place.dispatchEvent(new Event("turned"));
    };
    this.canvas.addEventListener("pointerdown", (event) => {
      dragging = true;
      this.canvas.setPointerCapture(event.pointerId);
    });
    this.canvas.addEventListener("pointermove", (event) => {
      if (dragging) turned(event.movementX * TURN_PER_PIXEL, event.movementY * TURN_PER_PIXEL);
    });
    for (const name of ["pointerup", "pointercancel"]) this.canvas.addEventListener(name, () => (dragging = false));
    this.canvas.addEventListener("keydown", (event) => {
      const step = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key];
      if (!step) return;
      event.preventDefault();
      turned(step[0] * TURN_PER_KEY, step[1] * TURN_PER_KEY);
    });
    this.canvas.addEventListener(
      "wheel",
      (event) => {
        if (!event.ctrlKey && document.activeElement !== this.canvas) return; // the page scrolls
        event.preventDefault();
        this.distance = Math.min(FARTHEST_M, Math.max(NEAREST_M, this.distance * Math.exp(event.deltaY / 1000)));
        this.place.dispatchEvent(new Event("turned"));
      },
      { passive: false },
    );
  }
}

/** A leg's part along `end`, thinner toward the foot. @param {three.Vector3} end @param {number} number @param {three.Material} material */
function limb(end, number, material) {
  const length = end.length();
  const [thick, thin] = number === 3 ? [0.015, 0.006] : [0.014, 0.012];
  const mesh = new three.Mesh(new three.CylinderGeometry(thin, thick, length, number === 3 ? 10 : 8, 4), material);
  mesh.position.copy(end).multiplyScalar(0.5);
  mesh.quaternion.setFromUnitVectors(new three.Vector3(0, 1, 0), end.clone().normalize());
  mesh.castShadow = true;
  return mesh;
}

/** Squares on a round floor. @param {three.LineBasicMaterial} material */
function mesh(material) {
  const points = [];
  for (let line = -LINES; line <= LINES; line += 1) {
    const at = line * MESH_M;
    const end = Math.sqrt((LINES * MESH_M) ** 2 - at ** 2);
    points.push(new three.Vector3(at, -end, 0), new three.Vector3(at, end, 0));
    points.push(new three.Vector3(-end, at, 0), new three.Vector3(end, at, 0));
  }
  return new three.LineSegments(new three.BufferGeometry().setFromPoints(points), material);
}

/** @param {number} radius @param {three.LineBasicMaterial} material */
function circle(radius, material) {
  const points = Array.from({ length: 97 }, (_, i) => {
    const angle = (i / 96) * 2 * Math.PI;
    return new three.Vector3(radius * Math.cos(angle), radius * Math.sin(angle), 0);
  });
  return new three.Line(new three.BufferGeometry().setFromPoints(points), material);
}

/** @param {string} variable of the style sheet */
function colour(variable) {
  return getComputedStyle(document.documentElement).getPropertyValue(variable).trim();
}
