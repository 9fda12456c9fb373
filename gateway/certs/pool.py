"""Common names: a role, and a number from a pool that the robot's rules list in advance.

Zenoh's access control identifies a laptop only by its whole common name, without patterns. So each laptop has its own,
such as `operator-07`, which can be removed from the rules alone; and the rules list the whole pool, so that a new
laptop needs no change on the robot. In a fleet the robot's name follows: `operator-07.robot-1`. A bare `operator` is
of the old layout and cannot be revoked alone.
"""

import re
from collections.abc import Iterable
from typing import Final, NamedTuple

from gateway.certs import LAPTOP_ROLES

SIZE: Final = 64
"""Common names of each role. An issued laptop keeps its name for ever, also once it is revoked."""
MAX_POOL: Final = 1000
"""Of each role. Zenoh compares a name with those of all rules when a session opens."""

NO_COMMON_NAME: Final = "(nobody)"
"""A common name without a certificate, for a subject whose names are all revoked: Zenoh takes one without names as
everyone."""

ALL: Final = "robots.all"
"""The group of all robots of a fleet, also future ones. No other group has this name: a robot's name has no dot, and
`group` sorts names."""

_COMMON_NAME: Final = re.compile(r"(?P<role>[a-z]+)(?:-(?P<number>\d{2,4}))?(?:\.(?P<robot>.+))?")


class Holder(NamedTuple):
    """A parsed common name. `number`: None in the old layout. `robot`: of a fleet, the robot or group; else ""."""

    role: str
    number: int | None
    robot: str

    @property
    def of(self) -> str:
        """The role without the number: `operator`, in a fleet `operator.robot-1`."""
        return f"{self.role}.{self.robot}" if self.robot else self.role

    @property
    def robots(self) -> tuple[str, ...]:
        """The robots of a fleet that it is valid for; `ALL` alone: all."""
        return (ALL,) if self.robot == ALL else tuple(filter(None, self.robot.split(".")))

    def is_for(self, robot: str) -> bool:
        """Whether it is valid for this robot of a fleet; "": for one without a fleet."""
        return robot in self.robots or (self.robot == ALL if robot else not self.robot)


def holder(common_name: str) -> Holder:
    """Parse a common name; one that is not a laptop's counts as a role without a number."""
    found = _COMMON_NAME.fullmatch(common_name)
    if found is None or found["role"] not in LAPTOP_ROLES:
        return Holder(common_name, None, "")
    return Holder(found["role"], None if found["number"] is None else int(found["number"]), found["robot"] or "")


def is_before(common_name: str, first: int) -> bool:
    """Whether it is a laptop's of an older CA than the one whose first number is `first`."""
    found = holder(common_name)
    return found.role in LAPTOP_ROLES and (found.number is None or found.number < first)


def group(robots: Iterable[str]) -> str:
    """The part of a common name for these robots."""
    return ".".join(sorted(set(robots)))


def common_name(role: str, number: int, robot: str = "") -> str:
    """`operator-07`, in a fleet `operator-07.robot-1`."""
    return f"{role}-{number:02}" + (f".{robot}" if robot else "")


def names(role: str, numbers: Iterable[int], robot: str = "") -> list[str]:
    """All common names of a role in the rules: the old layout's, and the pool."""
    bare = f"{role}.{robot}" if robot else role
    return [bare, *(common_name(role, number, robot) for number in numbers)]
