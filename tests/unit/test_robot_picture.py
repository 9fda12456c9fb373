"""docs/robot.svg shows the robot of the geometry file, as it is today."""

from gateway.geometry import load
from tests.support.robot_picture import FILE, picture


def test_the_picture_is_that_of_the_geometry() -> None:
    """Made anew by `python -m tests.support.robot_picture`."""
    assert FILE.read_text() == picture(load())
