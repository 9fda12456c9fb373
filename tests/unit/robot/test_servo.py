"""The life of a servo: every state with every event, and who may change it."""

import ast
from collections.abc import Callable, Iterator
from dataclasses import fields
from pathlib import Path
from typing import Final

import pytest

from gateway.model.calibration import RobotCalibration
from gateway.model.frames import SETS, STARTS
from gateway.robot.core import servo as module
from gateway.robot.core.events import Command
from gateway.robot.core.servo import AFTER, OFF, RUNNING, WAITING, IllegalTransition, Life, Servo

ROBOT: Final = Path(module.__file__).parents[1]
COMMAND: Final = Command(((11, STARTS[20_00]),), source="anna")
EVENTS: Final[dict[str, Callable[[Servo], object]]] = {
    "start": lambda servo: servo.take(STARTS[90_00], COMMAND),
    "set": lambda servo: servo.take(SETS[90_00], COMMAND),
    "frame": lambda servo: servo.wrote_target(7),
    "drop": lambda servo: servo.drop(),
    "stop": lambda servo: servo.stop(7, RobotCalibration()),
}


def in_state(life: Life) -> Servo:
    """Return a servo in this state; one that runs has a new target."""
    servo = Servo(11)
    if life is not OFF:
        servo.take(STARTS[20_00], COMMAND)
    if life is RUNNING:
        servo.wrote_target(5)
        servo.take(SETS[30_00], COMMAND)
    return servo


def values(servo: Servo) -> list[object]:
    return [getattr(servo, each.name) for each in fields(Servo)]


@pytest.mark.parametrize("life", Life)
@pytest.mark.parametrize("event", EVENTS)
def test_each_event_leads_where_the_table_says_or_changes_nothing(event: str, life: Life) -> None:
    servo = in_state(life)
    before = values(servo)
    if life in AFTER[event]:
        EVENTS[event](servo)
        assert servo.life is AFTER[event][life]
        assert (servo.angle_cdeg is not None) is (servo.life is RUNNING)
        assert servo.target is not None or servo.life is not WAITING
    else:
        with pytest.raises(IllegalTransition, match="servo 11 is off"):
            EVENTS[event](servo)
        assert values(servo) == before


def test_only_a_running_servo_without_a_target_goes_the_usual_way() -> None:
    for life in Life:
        servo = in_state(life)
        before = values(servo)
        with pytest.raises(IllegalTransition):
            servo.moved(SETS[40_00], 9)
        assert values(servo) == before


def assigned(path: Path) -> Iterator[str]:
    """Yield the names of the attributes that a file assigns."""
    for node in ast.walk(ast.parse(path.read_text())):
        targets = node.targets if isinstance(node, ast.Assign) else []
        targets += [node.target] if isinstance(node, ast.AugAssign | ast.AnnAssign) else []
        for target in targets:
            for each in target.elts if isinstance(target, ast.Tuple) else (target,):
                if isinstance(each, ast.Attribute) and ast.unparse(each.value) != "self":
                    yield each.attr


def test_no_other_file_assigns_the_fields_of_a_servo() -> None:
    """Other values have some of these names, too, and assign them to `self`, or to what is no servo."""
    own = {each.name for each in fields(Servo)} - {"sender", "command"}
    found = {
        f"{path.name}: {name}"
        for path in ROBOT.rglob("*.py")
        if path != Path(module.__file__)
        for name in assigned(path)
        if name in own
    }
    assert not found
