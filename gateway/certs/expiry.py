"""Sentences about a certificate that expires, for the log, systemd, `check` and `status`."""

import datetime as dt
from typing import Final

WARN_DAYS: Final = 60
"""Long enough to find the person who has the CA's key."""


def soon(name: str, end: dt.datetime, now: dt.datetime) -> str | None:
    """`gateway.pem expires on 2028-11-22, in 59 days`; None while more than WARN_DAYS are left."""
    left_days = (end - now) // dt.timedelta(days=1)
    if end <= now:
        return f"{name} expired on {end:%Y-%m-%d}"
    if left_days >= WARN_DAYS:
        return None
    return f"{name} expires on {end:%Y-%m-%d}, in {left_days} day{'' if left_days == 1 else 's'}"


def remedy(file: str, role: str, name: str) -> str:
    """How to renew the certificate in `file`; `role` and `name` as `folder.describe` returns them."""
    if role == "ca":
        return "hexapod-gateway certs init --host ROBOT --dir DIR in another folder, and issue all certificates again"
    holder = name if role != "gateway" else role
    return f"{renewal(holder)}, and copy {file} here"


def renewal(holder: str) -> str:
    """The command that renews a certificate; DIR is for a person to fill in."""
    return f"where ca.key is: hexapod-gateway certs renew {holder} --dir DIR"
