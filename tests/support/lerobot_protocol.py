"""What `examples/lerobot` uses of LeRobot 0.6, without its gigabytes: the abstract methods, and how plug-ins register.

`tests/zenoh/test_lerobot.py` compares it with the released LeRobot, where that is installed.
"""

import abc
import sys
from collections.abc import Callable
from dataclasses import dataclass
from types import ModuleType
from typing import Any, ClassVar, Final

ROBOT: Final = (
    *("action_features", "calibrate", "configure", "connect", "disconnect", "get_observation", "is_calibrated"),
    *("is_connected", "observation_features", "send_action"),
)
TELEOPERATOR: Final = (
    *("action_features", "calibrate", "configure", "connect", "disconnect", "feedback_features", "get_action"),
    *("is_calibrated", "is_connected", "send_feedback"),
)


@dataclass(kw_only=True)
class Config:
    """A RobotConfig or a TeleoperatorConfig."""

    known: ClassVar[dict[str, type]] = {}
    id: str | None = None

    def __post_init__(self) -> None:
        pass

    @classmethod
    def register_subclass(cls, name: str) -> Callable[[type], type]:
        return lambda found: cls.known.setdefault(name, found)


def abstract(name: str, methods: tuple[str, ...]) -> type:
    """Return an abstract class with these methods and properties, whose constructor takes a configuration."""
    body: dict[str, Any] = {each: abc.abstractmethod(lambda *_: None) for each in methods}
    body["__init__"] = lambda self, config: setattr(self, "id", config.id)
    return abc.ABCMeta(name, (), body)


def install() -> None:
    """Put modules of these names in place of LeRobot."""
    configs = {kind: type(kind, (Config,), {"known": {}}) for kind in ("RobotConfig", "TeleoperatorConfig")}
    errors = {
        name: type(name, (ConnectionError,), {}) for name in ("DeviceAlreadyConnectedError", "DeviceNotConnectedError")
    }
    contents: dict[str, dict[str, Any]] = {
        "lerobot": {},
        "lerobot.cameras": {"CameraConfig": object},
        "lerobot.cameras.utils": {
            "make_cameras_from_configs": lambda configs: {name: configs[name]() for name in configs}
        },
        "lerobot.robots": {"Robot": abstract("Robot", ROBOT), "RobotConfig": configs["RobotConfig"]},
        "lerobot.teleoperators": {
            "Teleoperator": abstract("Teleoperator", TELEOPERATOR),
            "TeleoperatorConfig": configs["TeleoperatorConfig"],
        },
        "lerobot.utils": {},
        "lerobot.utils.errors": errors,
    }
    for name, attributes in contents.items():
        sys.modules[name] = module = ModuleType(name)
        vars(module).update(attributes)
