"""Common names: the role, and a number from a pool that the robot's rules list once and for all.

Zenoh's access control compares a certificate's common name whole (no patterns), and knows a laptop by nothing else. So
each laptop has a common name of its own, `operator-07`, which can be taken out of the rules alone; and the rules list
all names of the pool from the beginning, so that a laptop that is new tomorrow needs no change on the robot. In a fleet
the robot's name follows: `operator-07.robot-1`. A bare `operator` is the layout before: it cannot be revoked alone.
"""

import re
from collections.abc import Iterable
from typing import Final, NamedTuple

from gateway.certs import LAPTOP_ROLES

SIZE: Final = 64
"""Common names of each role. A laptop that is issued takes one for good, also when it is revoked."""
MAX_POOL: Final = 1000
"""Of each role. Zenoh compares a name with those of all rules when a session opens."""

NO_COMMON_NAME: Final = "(nobody)"
"""No certificate of `certs` has this common name. It stands in a subject of which all are revoked: to Zenoh, a subject
without names is everybody."""

ALL: Final = "robots.all"
"""The group of all robots of a fleet, also of those that are added later. No other group is called so: a robot's name
has no dot, and `group` puts names in order."""

_COMMON_NAME: Final = re.compile(r"(?P<role>[a-z]+)(?:-(?P<number>\d{2,4}))?(?:\.(?P<robot>.+))?")


class Holder(NamedTuple):
    """What a common name says. `number` is None in the layout before.

    `robot` is "" outside a fleet, and in one the robot or the group of robots that it is for.
    """

    role: str
    number: int | None
    robot: str

    @property
    def of(self) -> str:
        """The role without the number: `operator`, in a fleet `operator.robot-1`."""
        return f"{self.role}.{self.robot}" if self.robot else self.role

    @property
    def robots(self) -> tuple[str, ...]:
        """The robots that it is for; `ALL` alone for all of them."""
        return (ALL,) if self.robot == ALL else tuple(filter(None, self.robot.split(".")))

    def is_for(self, robot: str) -> bool:
        """Whether it is for this robot of a fleet; "": for one outside."""
        return robot in self.robots or (self.robot == ALL if robot else not self.robot)


def holder(common_name: str) -> Holder:
    """Of any common name: one that is no laptop's is a role of its own, without a number."""
    found = _COMMON_NAME.fullmatch(common_name)
    if found is None or found["role"] not in LAPTOP_ROLES:
        return Holder(common_name, None, "")
    return Holder(found["role"], None if found["number"] is None else int(found["number"]), found["robot"] or "")


def is_before(common_name: str, first: int) -> bool:
    """Whether it is a laptop's of before the CA whose first number this is."""
    found = holder(common_name)
    return found.role in LAPTOP_ROLES and (found.number is None or found.number < first)


def group(robots: Iterable[str]) -> str:
    """These robots, as a common name has them."""
    return ".".join(sorted(set(robots)))


def common_name(role: str, number: int, robot: str = "") -> str:
    """`operator-07`, in a fleet `operator-07.robot-1`."""
    return f"{role}-{number:02}" + (f".{robot}" if robot else "")


def names(role: str, numbers: Iterable[int], robot: str = "") -> list[str]:
    """All common names of a role that the rules list: that of the layout before, and the pool."""
    bare = f"{role}.{robot}" if robot else role
    return [bare, *(common_name(role, number, robot) for number in numbers)]
