"""When may a frame leave? One file for each reason to wait, and `every.py`, which asks them all. Pure."""

from typing import Final

NEVER: Final = 2**63
"""Later than any time."""
