"""The gateway service and its tools."""

import schemas

__version__ = "1.1.0"

try:
    import schemas.robot
except ImportError:  # a module or a package of the program that imports this
    raise ImportError(f"{schemas.__file__} hides the gateway's package of that name; rename it") from None
