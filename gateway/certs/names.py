"""Common names of laptops: the role and a number, such as `operator-07`.

Zenoh's access control identifies a laptop by its whole common name, without patterns. So each laptop has a common name
of its own, which can be revoked alone. The rules in gateway.json5 name roles; the gateway replaces each role by its
common names when it starts (`robot/zenoh_io/revoked.py`), so that a new laptop needs no change on the robot.
"""

import re
from typing import Final

from gateway.certs import LAPTOP_ROLES

MOST: Final = 1000
"""Common names of each role. A laptop keeps its common name for ever, also once it is revoked."""

NOBODY: Final = "(nobody)"
"""A common name without a certificate, for a subject whose names are all revoked: Zenoh takes one without names as
everyone."""

_COMMON_NAME: Final = re.compile(rf"({'|'.join(LAPTOP_ROLES)})-\d{{2,3}}")


def every(role: str) -> list[str]:
    """Return all common names of a role."""
    return [f"{role}-{number:02}" for number in range(MOST)]


def role_of(common_name: str) -> str:
    """Return a laptop's role; for any other common name (`gateway`, `console`), the name itself."""
    found = _COMMON_NAME.fullmatch(common_name)
    return common_name if found is None else found[1]
