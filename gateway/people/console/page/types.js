/**
 * What the WebSocket carries, as far as the page reads it (gateway/people/console/pages/page_messages.py, schemas/telemetry.py).
 *
 * @typedef {{id: number, running: boolean, angle_deg: number | null}} Servo
 * @typedef {{leg: number, watchdog: string, age_ms: number | null, source: string | null, servos: Servo[]}} Leg
 * @typedef {{holder: string | null, asked_by: string | null, verified: boolean, held_s: number | null}} LeaseState
 * @typedef {{
 *   mode: string, time: string, uptime_s: number, version: string, simulated: boolean, physics?: string | null, estop: number, estop_source: string | null, estop_since?: string | null,
 *   legs: Leg[], commands: {accepted: number, rejected: number, coalesced: number},
 *   spi: {device: string, framing: string, frames: number, errors: number},
 *   watchdog: {timeout_ms: number, expirations: number,
 *              stop_latency_us: {p50: number | null, p99: number | null, max: number | null}},
 *   calibration?: {revision: number, fault: string | null, kept: boolean} | null, lease?: LeaseState | null, buttons?: {required: number, alive: number, names: string[]}, loop_lag_us?: {p50: number | null, p99: number | null, max: number | null} | null,
 *   controller?: {alive: boolean | null, age_ms: number | null}, battery?: Battery | null,
 * }} GatewayState
 * @typedef {{time: string, kind: string, source: string | null, key: string | null, reason: string | null,
 *            detail: string, left_out?: number, legs?: number[], tone?: "bad" | "warn" | "plain"}} GatewayEvent
 *
 * @typedef {{voltage_v: number, percent: number}} Battery
 * @typedef {{age_ms: number, temperature_c?: number, battery?: Battery, imu?: {orientation_wxyz: number[]}, tilt_deg?: number,
 *            feet?: (number | null)[], servos?: Record<string, {supplied: boolean, current_a?: number}>,
 *            supply?: {voltage_v: number, current_a: number}}} Telemetry
 *
 * @typedef {{type: "hello", role: "operator" | "button" | "observer", person: string, source: string, names: string[], version: string,
 *            geometry: Geometry, lying: Record<string, number>, gaits: string[], last_id: number}} Hello
 * @typedef {{type: "state", age_ms: number, now: string, whole: boolean, power: string, unconfirmed: string, state: GatewayState}} StateMessage
 * @typedef {{type: "telemetry", telemetry: Telemetry}} TelemetryMessage
 * @typedef {{type: "link", status: "connected" | "silent" | "gone", detail: string}} LinkMessage
 * @typedef {{type: "event", event: GatewayEvent, left_out?: number, tone: "bad" | "warn" | "plain"}} EventMessage
 * @typedef {{type: "ack", id: number, took_ms: number, error: string | null,
 *            ack: {accepted: boolean, reason?: string, detail?: string} | null}} AckMessage
 * @typedef {{type: "stop", id: number, asked_ms_ago: number, answered: boolean, attempts: number,
 *            stop_frames: number | null, latency_us: number | null, estop: number | null, power: string,
 *            error: string | null}} StopMessage
 * @typedef {{type: "lease", mine: boolean, id?: number | null, accepted?: boolean | null, reason?: string | null,
 *            detail?: string | null, holder?: string | null, verified?: boolean | null,
 *            ttl_ms?: number | null, end?: "page_silent" | "taken" | "gateway" | null, silent_s?: number | null}} LeaseMessage
 *
 * @typedef {{type: "walk", press: number, id: number | null, posture: string | null, now: string, gait: string | null,
 *            height_m: number | null, commanded: number[], scaled: number[], limit: string, lost: number[],
 *            ground: string, waits: boolean, detail: string}} WalkMessage
 *
 * @typedef {{trim_deg: number, inverted: boolean, min_deg: number, max_deg: number, changed: boolean}} Draft
 * @typedef {{type: "calibration", id: number, revision: number | null, servos: Record<number, Draft>,
 *            landing: Record<number, number>, servo: number | null, shown_deg: number | null,
 *            command_deg: number | null, error: string | null, said: string | null}} CalibrationMessage
 *
 * @typedef {{position_m: Vector, orientation_xyzw: [number, number, number, number], upright: boolean, terrain: string,
 *            real_time_factor: number, servos: Record<string, {angle_deg: number, torque_nm: number}>}} Body
 * @typedef {[number, number, number]} Vector
 * @typedef {{xyz_m: Vector, yaw_rad: number}} Mount
 * @typedef {{origin_xyz_m: Vector, origin_rpy_rad?: Vector, axis?: Vector}} Link
 * @typedef {{name?: string, leg_mounts: Record<string, Mount>, chain: Link[],
 *            servos: Record<string, {zero_deg: number, direction: 1 | -1}>}} Geometry
 */

export {};
