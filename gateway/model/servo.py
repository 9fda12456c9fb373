"""The servo of the Elkapod's drawings, an MG996R."""

from typing import Final

NO_LOAD_DEG_S: Final = 60 / 0.17
"""At 4.8 V it takes 0.17 s for 60°."""
