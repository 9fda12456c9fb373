/**
 * What the console sends on the WebSocket. Reports of the gateway are those of `schemas/`, as far as the page
 * reads them; the page's own messages are in gateway/people/console/pages/page_messages.py. A field that the console has
 * no value for may be absent or null.
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
 * @typedef {{voltage_v: number, percent: number | null}} Battery
 * @typedef {{age_ms: number, temperature_c?: number, battery?: Battery, imu?: {orientation_wxyz: number[]}, tilt_deg?: number,
 *            feet?: (number | null)[], servos?: Record<string, {supplied: boolean, current_a?: number}>,
 *            supply?: {voltage_v: number, current_a: number}}} Telemetry
 *
 * The first message. `source` is this page's name in state and events (`anna (page 3)`), `person` its holder's. `names`
 * are `source` and those of the pages before it in its tab, on which it drives on. `lying`: each servo's angle when the
 * robot lies on its belly, as in commands; empty if it cannot lie. `last_id`: the last id of the page that was reloaded
 * in this tab; the new page's numbers begin after it. `cameras`: names of those that it may show; by a picture that is
 * older than `stale_ms` nothing moves (0: at any age). `page` is a secret, by which it asks for pictures. `commands`
 * start the console again, and print a link to it.
 * @typedef {{type: "hello", role: "operator" | "button" | "observer", person: string, source: string, names: string[], version: string,
 *            geometry: Geometry, lying: Record<string, number>, gaits: string[], last_id: number, page?: string, cameras?: string[], stale_ms?: number, commands?: {start: string, link: string}}} Hello
 * The newest state, received `age_ms` ago. `now`: what the robot does, in one sentence without its full stop. `whole`:
 * its six legs start and stop only together. `power`: how the power board feeds the servos; `unconfirmed`: the sentence
 * to show in red while it does not confirm a Stop; both empty if there is none.
 * @typedef {{type: "state", age_ms: number, now: string, whole: boolean, power: string, unconfirmed: string, state: GatewayState}} StateMessage
 * @typedef {{type: "telemetry", telemetry: Telemetry}} TelemetryMessage
 * `silent`: linked, but no state comes; `gone`: no gateway is reached. `detail` states why, one line for each host.
 * @typedef {{type: "link", status: "connected" | "silent" | "gone" | "connecting", detail: string}} LinkMessage
 * `left_out`: how many events before it were not sent.
 * @typedef {{type: "event", event: GatewayEvent, left_out?: number, tone: "bad" | "warn" | "plain"}} EventMessage
 * @typedef {{type: "ack", id: number, took_ms: number, error: string | null,
 *            ack: {accepted: boolean, reason?: string, detail?: string} | null}} AckMessage
 * The progress of `stop_all`: sent at once, after each unanswered attempt, and when it is confirmed. While `answered` is
 * false the console goes on requesting it. `power`: the power board's confirmation, which ends a sentence.
 * @typedef {{type: "stop", id: number, asked_ms_ago: number, answered: boolean, attempts: number,
 *            stop_frames: number | null, latency_us: number | null, estop: number | null, power: string,
 *            error: string | null}} StopMessage
 * Whether this page has the lease: the answer to its request, or sent when the lease is lost, `silent_s` after it was
 * last granted. `end`: the page asked for none in time; somebody has taken it; the gateway ended it or was silent.
 * @typedef {{type: "lease", mine: boolean, id?: number | null, accepted?: boolean | null, reason?: string | null,
 *            detail?: string | null, holder?: string | null, verified?: boolean | null,
 *            ttl_ms?: number | null, end?: "page_silent" | "taken" | "gateway" | null, silent_s?: number | null}} LeaseMessage
 *
 * The progress of the page's walk: ten times a second, and once when it is over (`posture` null). `now`: what the robot
 * does, as in `state`. `id`: the newest wish that was used. `waits`: the newest press is used up. `commanded` and
 * `scaled` (what the legs can do of it; `limit` states why) are forward and left in m/s, and the turn in rad/s. `lost`:
 * legs that somebody else has stopped. `ground`: what a walk by sensors feels. `detail`: why it ended, or waits.
 * @typedef {{type: "walk", press: number, id: number | null, posture: string | null, now: string, gait: string | null,
 *            height_m: number | null, commanded: number[], scaled: number[], limit: string, lost: number[],
 *            ground: string, waits: boolean, detail: string}} WalkMessage
 *
 * @typedef {{trim_deg: number, inverted: boolean, min_deg: number, max_deg: number, changed: boolean}} Draft
 * The guide's state. `changed`: the draft differs from the calibration in force. `shown_deg` is the angle of the servo
 * under test by the draft; `command_deg` the same by the calibration in force, which the page commands. `error`: what was
 * not done and why.
 * @typedef {{type: "calibration", id: number, revision: number | null, servos: Record<number, Draft>,
 *            landing: Record<number, number>, servo: number | null, shown_deg: number | null,
 *            command_deg: number | null, error: string | null, note: string | null}} CalibrationMessage
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
