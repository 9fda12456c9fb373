"""The gateway service and its tools."""

import schemas

__version__ = "1.1.0"

if not hasattr(schemas, "__path__"):  # a module: ours is a package
    raise ImportError(f"{schemas.__file__} hides the gateway's package of that name; rename it")
