"""Numbers of programs: Python's, numpy's, and whatever else has `__float__`. Pure."""

from typing import SupportsFloat, SupportsIndex


def plain(value: object) -> float | None:
    """Return a program's number as a float; None if it is none: a bool, a string, an array of several."""
    if isinstance(value, bool) or str(getattr(value, "dtype", "")) == "bool":
        return None
    try:
        return float(value) if isinstance(value, SupportsFloat | SupportsIndex) else None
    except TypeError:
        return None
