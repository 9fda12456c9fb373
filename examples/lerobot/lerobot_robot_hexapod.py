"""The hexapod in LeRobot: `--robot.type=hexapod`, and `--teleop.type=hexapod` to drive it. See README.md.

Angles are degrees of the servos, velocities metres and radians a second of the body. A value that the robot does not
measure is 0, since LeRobot's statistics take no NaN.
"""

import time
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from lerobot.cameras import CameraConfig
from lerobot.cameras.utils import make_cameras_from_configs
from lerobot.robots import Robot, RobotConfig
from lerobot.teleoperators import Teleoperator, TeleoperatorConfig
from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError

from gateway.client import Client, GatewayError, GatewayState, Stream, Telemetry, Walk
from schemas.words import Mode

SERVOS = [10 * leg + joint for leg in range(1, 7) for joint in (1, 2, 3)]
ANGLES = [f"joint_{servo}.pos" for servo in SERVOS]
TARGETS = [f"joint_{servo}.target" for servo in SERVOS]
VELOCITIES = ["forward.vel", "left.vel", "turn.vel", "gait"]
GAITS = ("tripod", "ripple", "wave")
"""The action `gait` is the number of one of these."""
MEASURED = ["battery_v", "tilt_deg", *(f"foot_{leg}" for leg in range(1, 7))]
MODES: list[str] = [*Mode]
HZ = 50


@RobotConfig.register_subclass("hexapod")
@dataclass(kw_only=True)
class HexapodConfig(RobotConfig):
    """`actions`: `velocities` of the body and its gait, or the 18 `angles`, which go at `max_deg_s` at most."""

    endpoint: str = "tcp/127.0.0.1:7447"
    zenoh_config: Path | None = None
    actions: str = "velocities"
    max_deg_s: float = 180.0
    cameras: dict[str, CameraConfig] = field(default_factory=dict)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.actions not in ("velocities", "angles"):
            raise ValueError(f"actions are `velocities` or `angles`, not `{self.actions}`")
        for camera in self.cameras.values():
            address = str(getattr(camera, "index_or_path", ""))
            if address.startswith(("http:/", "https:/")):  # a Path has lost the second slash
                camera.index_or_path = address.replace(":/", "://", 1)


class Hexapod(Robot):
    """The robot. `connect` takes the lease and moves nothing; the first velocity makes the robot stand up."""

    config_class = HexapodConfig
    name = "hexapod"
    is_calibrated = True

    def __init__(self, config: HexapodConfig) -> None:
        super().__init__(config)
        self.config, self.cameras = config, make_cameras_from_configs(config.cameras)
        for camera in self.cameras.values():
            if "://" in str(getattr(camera, "index_or_path", "")):  # OpenCV sets neither size nor rate of a stream
                camera.width = camera.height = camera.fps = None
        self._client: Client | None = None
        self._lease: Any = None
        self._walk: Walk | None = None
        self._stream: Stream | None = None
        self._measured: Telemetry | None = None
        self._sent: dict[str, float] = {}
        self._sent_s = 0.0

    @property
    def action_features(self) -> dict[str, type]:
        return dict.fromkeys(VELOCITIES if self.config.actions == "velocities" else ANGLES, float)

    @property
    def observation_features(self) -> dict[str, Any]:
        pictures = {name: (each.height, each.width, 3) for name, each in self.config.cameras.items()}
        return {**dict.fromkeys([*ANGLES, *TARGETS, "mode", *MEASURED], float), **pictures}

    @property
    def is_connected(self) -> bool:
        return self._client is not None

    def calibrate(self) -> None:
        """`hexapod-gateway calibrate` does that."""

    def configure(self) -> None: ...

    def connect(self, calibrate: bool = True) -> None:
        """Take the lease and open the cameras. Raises ConnectionError with the sentence of a failure."""
        if self.is_connected:
            raise DeviceAlreadyConnectedError(f"{self} is connected")
        with ExitStack() as failed:
            failed.callback(self.disconnect)
            try:
                client = Client(self.config.endpoint, zenoh_config=self.config.zenoh_config, source="lerobot")
                self._client, self._lease = client, client.lease()
                self._lease.__enter__()
                client.on_telemetry(self._measure)
                if self.config.actions == "velocities":
                    self._walk = client.walk(hz=HZ).open()
                else:
                    self._stream = client.stream(HZ).open()
            except GatewayError as error:
                raise ConnectionError(str(error)) from None
            for camera in self.cameras.values():
                camera.connect()
            failed.pop_all()

    def _measure(self, telemetry: Telemetry) -> None:
        self._measured = telemetry

    def get_observation(self) -> dict[str, Any]:
        state, new = self._state(), self._measured
        servos = [servo for leg in state.legs for servo in leg.servos]
        found = dict(zip(ANGLES, (servo.angle_deg or 0.0 for servo in servos), strict=True))
        found |= dict(zip(TARGETS, (servo.target_deg or 0.0 for servo in servos), strict=True))
        battery, tilt, feet = (new.battery, new.tilt_deg, new.feet) if new is not None else (None, None, None)
        volts = battery.voltage_v if battery is not None else 0.0
        found |= dict(zip(MEASURED, (volts, tilt or 0.0, *(feet or [0.0] * 6)), strict=True))
        found["mode"] = float(MODES.index(state.mode) if state.mode in MODES else -1)
        return {**found, **{name: camera.read_latest() for name, camera in self.cameras.items()}}

    def _state(self) -> GatewayState:
        try:
            return self._connected().state()
        except GatewayError as error:
            raise self._ended(error) from None

    def send_action(self, action: dict[str, Any]) -> dict[str, float]:
        """Drive, and return what was sent: angles are limited to `max_deg_s`. Raises ConnectionError after a Stop."""
        self._connected()
        wanted = {name: float(action[name]) for name in self.action_features}
        try:
            sent = self._set(self._stream, wanted) if self._walk is None else self._go(self._walk, wanted)
        except GatewayError as error:
            raise self._ended(error) from None
        self._sent, self._sent_s = sent, time.monotonic()
        return sent

    def _go(self, walk: Walk, wanted: dict[str, float]) -> dict[str, float]:
        number = min(max(round(wanted["gait"]), 0), len(GAITS) - 1)
        if number != self._sent.get("gait", 0):
            walk.walk_as(GAITS[number])
        walk.go(*(wanted[name] for name in VELOCITIES[:3]), wait=False)
        return {**wanted, "gait": float(number)}

    def _set(self, stream: Any, wanted: dict[str, float]) -> dict[str, float]:
        known = self._sent or self._running()
        most = self.config.max_deg_s * min(time.monotonic() - self._sent_s, 0.1)
        sent = {}
        for name, angle in wanted.items():
            before = known.get(name, angle)
            sent[name] = min(max(angle, before - most), before + most)
        angles = list(sent.values())
        stream.set({leg: angles[3 * leg - 3 : 3 * leg] for leg in range(1, 7)})
        return sent

    def _running(self) -> dict[str, float]:
        angles = [angle for leg in self._state().legs for angle in leg.angles_deg]
        return {name: angle for name, angle in zip(ANGLES, angles, strict=True) if angle is not None}

    def disconnect(self) -> None:
        """Sit down (a walk), stop the servos, release the lease, close the cameras."""
        client, self._client = self._client, None
        self._walk, self._stream, self._sent = None, None, {}
        for camera in (each for each in self.cameras.values() if each.is_connected):
            camera.disconnect()
        with suppress(GatewayError):  # the servos are stopped already
            if client is not None:
                client.close()

    def _connected(self) -> Client:
        if self._client is None:
            raise DeviceNotConnectedError("call connect() first")
        return self._client

    def _ended(self, error: GatewayError) -> ConnectionError:
        return ConnectionError(f"the episode has ended: {error}")


@TeleoperatorConfig.register_subclass("hexapod")
@dataclass(kw_only=True)
class HexapodTeleopConfig(TeleoperatorConfig):
    """`keys`: w s a d q e drive at these speeds and 1 2 3 choose the gait; without, it drives at them steadily."""

    forward_m_s: float = 0.06
    left_m_s: float = 0.04
    turn_rad_s: float = 0.2
    gait: int = 0
    keys: bool = True


class HexapodTeleop(Teleoperator):
    """Velocities from the keyboard (an X11 session, Windows or macOS), or steady ones."""

    config_class = HexapodTeleopConfig
    name = "hexapod"
    feedback_features: dict[str, type] = {}
    is_calibrated = True

    def __init__(self, config: HexapodTeleopConfig) -> None:
        super().__init__(config)
        self.config, self._gait, self._there = config, float(config.gait), False
        self._keys: Any = None
        if config.keys:
            from lerobot.teleoperators.keyboard import KeyboardTeleop, KeyboardTeleopConfig

            self._keys = KeyboardTeleop(KeyboardTeleopConfig(id=config.id))

    @property
    def action_features(self) -> dict[str, type]:
        return dict.fromkeys(VELOCITIES, float)

    @property
    def is_connected(self) -> bool:
        return self._there

    def connect(self, calibrate: bool = True) -> None:
        if self._keys is not None:
            self._keys.connect()
            if not self._keys.is_connected:
                raise ConnectionError("no keyboard can be read here; --teleop.keys=false drives steadily")
        self._there = True

    def get_action(self) -> dict[str, float]:
        config = self.config
        ahead = aside = turn = 1.0
        if self._keys is not None:
            keys = set(self._keys.get_action())
            ahead, aside, turn = (float(more in keys) - (less in keys) for more, less in ("ws", "ad", "qe"))
            self._gait = next((float(int(key) - 1) for key in ("1", "2", "3") if key in keys), self._gait)
        velocities = ahead * config.forward_m_s, aside * config.left_m_s, turn * config.turn_rad_s
        return dict(zip(VELOCITIES, (*velocities, self._gait), strict=True))

    def send_feedback(self, feedback: dict[str, Any]) -> None: ...

    def calibrate(self) -> None: ...

    def configure(self) -> None: ...

    def disconnect(self) -> None:
        self._there = False
        if self._keys is not None and self._keys.is_connected:
            self._keys.disconnect()
